"""Writes to a disk that may hang, on a separate thread. The owner of the state receives the result."""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from gateway.errors import ConfigError
from gateway.host.worker import Worker
from gateway.robot.host.ownership import Ownership


class DiskWriter:
    """A worker that writes to a disk. A write that never ends delays only later writes of this worker."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop, owner: Ownership) -> None:
        self._loop = loop
        self._owner = owner
        self._worker = Worker(name)

    def write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        """Queue `write` and return at once. `then` is called afterwards by the owner of the state.

        `then` receives None, or the text of the ConfigError that `write` raised.
        """
        self._worker.do(lambda: self._write(write, then))

    def _write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        try:
            fault = None
            try:
                write()
            except ConfigError as error:
                fault = str(error)
            with self._owner:
                then(fault)
        except Exception as error:
            report_mistake(self._loop, f"the thread {self._worker.thread.name} failed", error)


def report_mistake(loop: asyncio.AbstractEventLoop, what: str, error: Exception) -> None:
    """Report `error` to the loop's exception handler, which ends the service. May be called from any thread."""
    with suppress(RuntimeError):  # the loop is closed: the service has ended
        loop.call_soon_threadsafe(loop.call_exception_handler, {"message": what, "exception": error})
