"""Programs of ours as forks of a process that has imported them: a start costs 0.05 s of processor time, not 0.5 s.

    python -m tests.support.zygote FD      serves requests that come by this socket

`Child` starts `python -m gateway …` and `python -m tests.…` so. A fork has the request's environment, folder and
standard streams, none of the server's files, and ends as any Python does. The server is one thread, so that nothing in
it is half done when it forks. `ZYGOTE=no` starts each program by itself, as users do.
"""

import atexit
import fcntl
import gc
import importlib
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TextIO

from tests.support.runs import MARK

READY: Final = b"ready\n"
_PREFIX: Final = (sys.executable, "-m")
_NEEDS_ROS: Final = ".ros2.run"
_ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1"}
"""NumPy starts a thread for each processor when it is imported."""
_MOST: Final = 1 << 17
"""A request's bytes: most of them are the environment."""
_DESCRIPTORS: Final = 4
"""A request's: stdin, stdout and stderr of the program, and the socket that gets its process id and exit status."""


def fits(command: Sequence[str], env: Mapping[str, str]) -> bool:
    """Return whether a fork does what this command would: it is ours, and Python behaves as here."""
    ours = command[2:3] == ["gateway"] or (command[2:3] or [""])[0].startswith("tests.")
    return (
        os.environ.get("ZYGOTE") != "no"
        and tuple(command[:2]) == _PREFIX
        and ours
        and _for_python(env) == _for_python(os.environ)
    )


def _for_python(env: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in env.items() if name.startswith("PYTHON")}


class Forked:
    """A fork with the part of `subprocess.Popen` that `Child` uses."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str], cwd: Path | None) -> None:
        self.returncode: int | None = None
        self._lock = threading.Lock()
        pipes = [os.pipe() for _ in range(3)]
        theirs = [pipes[0][0], pipes[1][1], pipes[2][1]]
        self._end, end = socket.socketpair()
        request = {
            "module": command[2],
            "arguments": list(command[3:]),
            "env": dict(env),
            "cwd": str(cwd or Path.cwd()),
        }
        with end:
            _server(env).ask(request, [*theirs, end.fileno()])
        for each in theirs:
            os.close(each)
        ours = (pipes[0][1], "w"), (pipes[1][0], "r"), (pipes[2][0], "r")
        self.stdin, self.stdout, self.stderr = (
            open(number, mode, buffering=1, encoding="utf-8", errors="replace")  # noqa: SIM115
            for number, mode in ours
        )
        line = b""
        while not line.endswith(b"\n"):
            received = self._end.recv(1)
            if not received:
                raise ChildProcessError(f"the fork server has ended: {' '.join(command)}")
            line += received
        self.pid = int(line)

    def poll(self) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Return its exit status, negative for a signal. Raises subprocess.TimeoutExpired."""
        ended = select.poll()
        if (number := self._end.fileno()) >= 0:  # else another thread has closed it
            ended.register(number, select.POLLIN)
            if not ended.poll(None if timeout is None else timeout * 1000):
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        with self._lock:  # two may have waited
            if self.returncode is None:
                with self._end:
                    status = self._end.recv(16)
                self.returncode = int(status) if status else -signal.SIGKILL
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)


class _Server:
    """One server process; it ends with this one, whose end of the socket closes then."""

    def __init__(self, env: Mapping[str, str]) -> None:
        self._lock = threading.Lock()
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [*_PREFIX, "tests.support.zygote", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env=env,
                cwd=Path(__file__).parents[2],
                stdin=subprocess.DEVNULL,
            )
        if self._channel.recv(len(READY)) != READY:
            raise ChildProcessError(f"the fork server does not start: it ended with {self._process.wait()}")
        atexit.register(self.close)

    def close(self) -> None:
        self._channel.close()
        self._process.wait()

    def ask(self, request: Mapping[str, Any], descriptors: Sequence[int]) -> None:
        with self._lock:
            socket.send_fds(self._channel, [json.dumps(request).encode()], list(descriptors))


_servers: Final[dict[tuple[str, ...], _Server]] = {}
_making: Final = threading.Lock()


def _server(env: Mapping[str, str]) -> _Server:
    """Return one that has the libraries and the run's mark of a program with `env`, and ends with this process."""
    preload, mark = env.get("LD_PRELOAD", ""), env.get(MARK, "")
    key = (str(os.getpid()), preload, mark)
    with _making:
        if key not in _servers:
            _servers[key] = _Server({**os.environ, **_ONE_THREAD, "LD_PRELOAD": preload, MARK: mark})
        return _servers[key]


# ---- the server's side


def serve(number: int) -> None:
    """Serve until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group, and this ends behind the tests
    command = _imported()
    channel = socket.socket(fileno=number)
    until_s = time.monotonic() + 30
    while len(threads := os.listdir("/proc/self/task")) > 1:  # a thread is there until the kernel removes it
        assert time.monotonic() < until_s, f"a fork would miss {[_name(thread) for thread in threads]}"
        time.sleep(0.001)
    channel.sendall(READY)
    poll = select.poll()
    poll.register(channel, select.POLLIN)
    running: dict[int, tuple[int, socket.socket]] = {}
    while True:
        for ready, _ in poll.poll():
            if ready != channel.fileno():
                poll.unregister(ready)
                _ended(ready, *running.pop(ready))
                continue
            data, descriptors, _, _ = socket.recv_fds(channel, _MOST, _DESCRIPTORS)
            if not data:
                return
            end = socket.socket(fileno=descriptors.pop())
            pid = os.fork()
            if pid == 0:
                for each in (channel, end, *(other for _, other in running.values())):
                    each.detach()  # so that no object closes a number that is another file's by then
                request = json.loads(data)
                _become(request, descriptors)
                _run(request["module"], command)
            for descriptor in descriptors:
                os.close(descriptor)
            pidfd = os.pidfd_open(pid)
            running[pidfd] = pid, end
            poll.register(pidfd, select.POLLIN)
            end.sendall(f"{pid}\n".encode())


def _name(thread: str) -> str:
    with suppress(OSError):  # it has ended
        return Path(f"/proc/self/task/{thread}/comm").read_text(encoding="utf-8").strip()
    return ""


def _imported() -> Callable[[], None]:
    """Import the gateway, and make what is imported stay where it is. Returns its command."""
    import gateway  # noqa: PLC0415

    for module in pkgutil.walk_packages(gateway.__path__, "gateway.", onerror=lambda _: None):
        name = module.name.rpartition(".")[2]
        if name != "__main__" and not module.name.endswith(_NEEDS_ROS):
            with suppress(Exception):  # a fork that needs the module imports it again, and then its error shows
                importlib.import_module(module.name)
    for name in ("spidev", "serial", "can"):
        with suppress(Exception):
            importlib.import_module(name)
    from gateway.__main__ import main  # noqa: PLC0415

    gc.collect()
    gc.freeze()
    return main


def _ended(pidfd: int, pid: int, end: socket.socket) -> None:
    os.close(pidfd)
    status = os.waitpid(pid, 0)[1]
    with end, suppress(OSError):  # nobody may want to know
        end.sendall(str(os.waitstatus_to_exitcode(status)).encode())


def _become(request: Mapping[str, Any], descriptors: Sequence[int]) -> None:
    """Be the process that was asked for, up to its first line of code."""
    moved = [fcntl.fcntl(each, fcntl.F_DUPFD, 3) for each in descriptors]
    for number, descriptor in enumerate(moved):
        os.dup2(descriptor, number, inheritable=True)
    for name in os.listdir("/proc/self/fd"):
        if int(name) > 2:
            with suppress(OSError):  # the one by which the folder was read
                os.close(int(name))
    os.environ.clear()
    os.environ.update(request["env"])
    time.tzset()
    os.chdir(request["cwd"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number, (stream, mode, buffering) in enumerate((("stdin", "r", -1), ("stdout", "w", -1), ("stderr", "w", 1))):
        old: TextIO = getattr(sys, stream)
        new = open(number, mode, buffering, encoding="utf-8", errors=old.errors, closefd=False)  # noqa: SIM115
        setattr(sys, stream, new)
        setattr(sys, f"__{stream}__", new)
    sys.argv = ["hexapod-gateway" if request["module"] == "gateway" else request["module"], *request["arguments"]]


def _run(module: str, command: Callable[[], None]) -> None:
    """Run until its end, which ends this process as it ends any Python."""
    if module == "gateway":
        command()
    else:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    sys.exit(0)


if __name__ == "__main__":
    serve(int(sys.argv[1]))
