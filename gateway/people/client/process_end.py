"""The end of a program that uses clients: signals that arrive in a Zenoh callback or while a robot walks, and clients
that are still open.

If no other program has to answer, Zenoh calls a query's callback in the asking thread. Exceptions in callbacks are only
logged, so the exception of a Ctrl-C or SIGTERM handler would be lost there. Therefore the signal is delivered again.

At its end Python waits for Zenoh's callback threads, which end with their session, and only then runs `atexit`
functions. So another thread closes the clients.
"""

import _thread
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from types import FrameType
from typing import Any, ClassVar, Final, Self
from weakref import WeakSet

from gateway.errors import ZenohError

_SIGNALS: Final = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}
"""The exceptions of handlers, and their signals."""
_AGAIN_S: Final = 0.01
"""Delay of the repeated signal; the callback has then returned. If it meets another callback, it is repeated again."""
_CALLBACKS: Final = "pyo3-closure"
"""Part of the names of Zenoh's own threads."""


_again: Final[list[int]] = []
"""Signals that are delivered again, and have not come yet."""
_processes: set[int] = set()
"""The process that has opened sessions; after a fork the child's own id is not among them."""


def forked() -> bool:
    """Return whether this process is the fork of one that opened sessions, whose threads and links it does not have."""
    return bool(_processes) and os.getpid() not in _processes


def check_fork() -> None:
    """Raise ZenohError in such a process: a session there can crash the other process."""
    if forked():
        spawn = 'start it by multiprocessing\'s "spawn" method'
        raise ZenohError(
            f"this process is the fork of one that has opened a client, and Zenoh survives no fork: {spawn}"
        )


def keep_signals() -> None:
    """Begin, for all sessions of this process. A second call changes nothing."""
    _processes.add(os.getpid())
    logging.getLogger("zenoh.handlers").addFilter(_is_no_signal)


def _is_no_signal(record: logging.LogRecord) -> bool:
    raised = record.exc_info[1] if record.exc_info else None
    for error, number in _SIGNALS.items():
        if isinstance(raised, error) and threading.current_thread() is threading.main_thread():
            # To the process: it ends a wait, too. On Windows os.kill would end the process.
            kill = partial(os.kill, os.getpid()) if os.name == "posix" else _thread.interrupt_main
            _again.append(number)
            again = threading.Timer(_AGAIN_S, kill, (number,))
            again.daemon = True
            again.start()
            return False
    return True


class Terminated(SystemExit):
    """SIGTERM arrived while a robot walks."""

    def __init__(self) -> None:
        super().__init__(128 + signal.SIGTERM)


class WalkSignals:
    """Signals in the main thread from `begin` to `end`. SIGTERM without a handler of the program raises Terminated."""

    _open: ClassVar[list["WalkSignals"]] = []
    _handlers: ClassVar[dict[int, Any]] = {}
    """The handlers of the signals before the first of these began. They stay: a signal may arrive meanwhile."""

    def __init__(self, end_now: Callable[[], object] = int) -> None:
        """`end_now` is called at each signal after the first, and if `end` is interrupted. `count` is how many came."""
        self.count = 0
        self._end_now = end_now

    def begin(self) -> Self:
        """Begin in the main thread. Elsewhere this does nothing, since Python delivers signals to the main thread."""
        if threading.current_thread() is threading.main_thread():
            if not self._open:
                _again.clear()
            self._open.append(self)
            for number in (signal.SIGINT, signal.SIGTERM) if len(self._open) == 1 else ():
                before = signal.getsignal(number)
                if callable(before) if number == signal.SIGINT else before == signal.SIG_DFL:
                    self._handlers[number] = before
                    signal.signal(number, self._received)
        return self

    @contextmanager
    def end(self) -> Iterator[None]:
        """Give the signals back to their handlers after the `with`, if no other robot walks."""
        try:
            yield
        except Exception:
            raise
        except BaseException:  # a signal or a cancellation
            self._end_now()
            raise
        finally:
            self._give_back()

    def _give_back(self) -> None:
        if self in self._open:
            self._open.remove(self)
        for number, before in self._handlers.items() if not self._open else ():
            if signal.getsignal(number) == self._received:
                signal.signal(number, before)

    @classmethod
    def _received(cls, number: int, frame: FrameType | None) -> None:
        """Count a signal, and leave it to its handler: `asyncio.run` cancels its main task at the first Ctrl-C."""
        if number in _again:
            _again.remove(number)
        else:
            cls._count()
        before = cls._handlers[number]
        if not callable(before):
            raise Terminated
        before(number, frame)

    @classmethod
    def _count(cls) -> None:
        for each in cls._open:
            each.count += 1
            if each.count > 1:
                each._end_now()


_open: WeakSet[AbstractContextManager[Any]] = WeakSet()
_lock: Final = threading.Lock()


def close_at_the_end(client: AbstractContextManager[Any]) -> None:
    """Close `client` when all threads of the program have ended, apart from Zenoh's and daemons."""
    with _lock:
        _open.add(client)
        if not any(isinstance(thread, _Closer) for thread in threading.enumerate()):
            with suppress(RuntimeError):  # the program is ending already
                _Closer(name="close clients at the end").start()


class _Closer(threading.Thread):
    def run(self) -> None:
        threading.main_thread().join()
        for thread in threading.enumerate():
            if not thread.daemon and thread is not self and _CALLBACKS not in thread.name:
                thread.join()
        error = getattr(sys, "last_value", None)  # what ended the program: a walk stops then, and does not sit down
        with _lock, ExitStack() as last:
            for client in list(_open):
                last.callback(client.__exit__, None if error is None else type(error), error, None)
