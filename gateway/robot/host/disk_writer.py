"""Writes to a disk that may hang: on a thread of its own, and the owner of the state learns how it went."""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from gateway.errors import ConfigError
from gateway.host.worker import Worker
from gateway.robot.host.ownership import Ownership


class DiskWriter:
    """A worker that writes to a disk. A write that never ends keeps its own caller waiting and nobody else."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop, owner: Ownership) -> None:
        self._loop = loop
        self._owner = owner
        self._worker = Worker(name)

    def write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        """Call `write`, and then, as owner of the state, `then`: with a sentence where it raised ConfigError.

        Returns at once.
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
    """As if it had happened on the loop, which ends the service after a mistake of our own. From any thread."""
    with suppress(RuntimeError):  # the loop is closed: the service has ended
        loop.call_soon_threadsafe(loop.call_exception_handler, {"message": what, "exception": error})
