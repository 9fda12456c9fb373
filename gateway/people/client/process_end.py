"""The end of a program that uses clients: signals that arrive in a Zenoh callback, and clients that are still open.

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
from contextlib import AbstractContextManager, ExitStack, suppress
from functools import partial
from typing import Any, Final
from weakref import WeakSet

_SIGNALS: Final = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}
"""The exceptions of handlers, and their signals."""
_AGAIN_S: Final = 0.01
"""Delay of the repeated signal; the callback has then returned. If it meets another callback, it is repeated again."""
_CALLBACKS: Final = "pyo3-closure"
"""Part of the names of Zenoh's own threads."""


def keep_signals() -> None:
    """Begin, for all sessions of this process. A second call changes nothing."""
    logging.getLogger("zenoh.handlers").addFilter(_is_no_signal)


def _is_no_signal(record: logging.LogRecord) -> bool:
    raised = record.exc_info[1] if record.exc_info else None
    for error, number in _SIGNALS.items():
        if isinstance(raised, error) and threading.current_thread() is threading.main_thread():
            # To the process: it ends a wait, too. On Windows os.kill would end the process.
            kill = partial(os.kill, os.getpid()) if os.name == "posix" else _thread.interrupt_main
            again = threading.Timer(_AGAIN_S, kill, (number,))
            again.daemon = True
            again.start()
            return False
    return True


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
