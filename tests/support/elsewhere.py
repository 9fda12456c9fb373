"""Runs a program as on Windows and macOS: without the modules, attributes and files that only Linux or POSIX has.

`python -m tests.support.elsewhere MODULE ARGUMENT…` runs a module as `python -m` does. What the standard library itself
needs of them here is kept for it.
"""

import asyncio
import builtins
import ctypes
import importlib
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any, Final, NoReturn


def _words(text: str) -> list[str]:
    return text.split()


MODULES: Final = ("fcntl", "termios", "tty", "pty", "pwd", "grp", "resource", "syslog", "readline", "curses", "spidev")
SIGNALS: Final = _words(
    "SIGHUP SIGQUIT SIGKILL SIGUSR1 SIGUSR2 SIGALRM SIGCHLD SIGCONT SIGSTOP SIGTSTP SIGTTIN SIGTTOU SIGWINCH SIGPIPE "
    "SIGRTMIN SIGRTMAX setitimer alarm pause pthread_kill pthread_sigmask sigwait sigwaitinfo sigtimedwait siginterrupt"
)
SYSTEM: Final = _words(
    "getuid geteuid getgid getegid getgroups setuid setgid setsid getsid getpgid getpgrp setpgid tcgetpgrp tcsetpgrp "
    "killpg fork forkpty nice getpriority setpriority chown fchown lchown fchmod fchdir chroot mkfifo mknod "
    "sysconf getloadavg statvfs fstatvfs sync pread pwrite preadv pwritev pipe2 posix_fallocate posix_fadvise openpty "
    "memfd_create eventfd sched_setscheduler sched_getscheduler sched_param sched_setaffinity sched_getaffinity "
    "sched_get_priority_max sched_get_priority_min sched_yield getrandom O_DIRECTORY O_NOFOLLOW O_PATH O_TMPFILE "
    "O_CLOEXEC O_NONBLOCK O_NOCTTY O_DSYNC O_SYNC SCHED_FIFO SCHED_OTHER SCHED_RR PRIO_PROCESS "
    "wait3 wait4 waitid pidfd_open WNOHANG listxattr getxattr setxattr removexattr ttyname ctermid"
)
SOCKETS: Final = _words("AF_UNIX AF_NETLINK AF_PACKET AF_CAN SO_PEERCRED SO_REUSEPORT SO_BINDTODEVICE SCM_RIGHTS")
CLOCKS: Final = _words("clock_gettime clock_gettime_ns clock_settime clock_getres CLOCK_BOOTTIME CLOCK_MONOTONIC_RAW")
POLLS: Final = _words("poll epoll kqueue")
TCP: Final = _words("TCP_USER_TIMEOUT TCP_NOTSENT_LOWAT TCP_INFO TCP_CORK TCP_QUICKACK")
FOLDERS: Final = ("/proc", "/sys", "/run", "/etc")


def forget() -> None:
    """Remove what only Linux or POSIX has, once the standard library has what it needs of it."""
    _keep_for_the_library()
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]  # it is not found
    sys.modules["msvcrt"] = _Msvcrt("msvcrt")
    lacks: list[tuple[Any, list[str]]] = [
        (signal, SIGNALS), (os, SYSTEM), (socket, SOCKETS + TCP), (time, CLOCKS), (select, POLLS)
    ]  # fmt: skip
    for module, names in lacks:
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    asyncio.BaseEventLoop.add_signal_handler = _not_implemented  # type: ignore[method-assign]
    asyncio.SelectorEventLoop.add_signal_handler = _not_implemented  # type: ignore[method-assign]
    asyncio.SelectorEventLoop.remove_signal_handler = _not_implemented  # type: ignore[method-assign]
    ctypes.CDLL = _no_library  # type: ignore[assignment, misc]
    builtins.open = os_open(builtins.open)
    os.open = os_open(os.open)


def _keep_for_the_library() -> None:
    """Keep what the standard library itself needs of this system."""
    pair, family = socket.socketpair, socket.AF_UNIX
    socket.socketpair = lambda *_, **__: pair(family)
    importlib.import_module("numpy")  # it knows its system by the platform
    subprocess.Popen([sys.executable, "-c", ""]).wait()  # it binds what it needs
    with tempfile.TemporaryFile():
        pass


def os_open(own: Callable[..., Any]) -> Callable[..., Any]:
    """Return an `open` for which Linux's own files are not there."""

    def opened(path: Any, *arguments: Any, **named: Any) -> Any:
        caller = sys._getframe(1).f_globals.get("__name__", "")
        ours = caller.partition(".")[0] in ("gateway", "schemas")
        if ours and isinstance(path, str | os.PathLike) and str(path).startswith(FOLDERS):
            raise FileNotFoundError(2, "No such file or directory", str(path))
        return own(path, *arguments, **named)

    return opened


class _Msvcrt(ModuleType):
    """What Windows has for locks."""

    LK_LOCK = 1

    @staticmethod
    def locking(descriptor: int, mode: int, count: int) -> None:
        assert (os.fstat(descriptor) and mode, count) == (1, 1)


def _not_implemented(*_: object, **__: object) -> NoReturn:
    raise NotImplementedError


def _no_library(name: object, *_: object, **__: object) -> NoReturn:
    if name is None:
        raise TypeError("a name is needed")
    raise OSError(f"no library {name}")


if __name__ == "__main__":
    forget()
    module, sys.argv[:] = sys.argv[1], [sys.argv[1], *sys.argv[2:]]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
