"""Closes the clients that a program forgot to close, so that it ends.

At its end Python waits for Zenoh's callback threads, which end with their session, and runs `atexit` functions only
after that wait.
"""

import threading
from contextlib import suppress
from typing import Final, Protocol
from weakref import WeakSet

_CALLBACKS: Final = "pyo3-closure"
"""Part of the names of Zenoh's own threads."""


class Closable(Protocol):
    """A client, as far as this module needs it."""

    def close(self) -> None: ...


_open: WeakSet[Closable] = WeakSet()
_lock: Final = threading.Lock()


def close_at_the_end(client: Closable) -> None:
    """Close it when all threads of the program have ended, apart from Zenoh's and daemons."""
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
        with _lock:
            forgotten = list(_open)
        for client in forgotten:
            client.close()
