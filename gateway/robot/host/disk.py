"""The state directory, and writes to its disk, which may hang: on a separate thread."""

import asyncio
import fcntl
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from gateway.errors import ConfigError
from gateway.host.worker import Worker
from gateway.robot.host.ownership import Ownership


class StateFolder:
    """A state directory, which one gateway writes. For any thread.

    A second one's reset would remove the first one's emergency stop, and its calibration replace the first one's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._ours: bool | None = None
        self._asking = threading.Lock()

    def own(self) -> None:
        """Lock the folder, at the first call, until this process ends. Waits for the disk.

        Raises ConfigError if another gateway had it then. It may have left an emergency stop, so its end changes
        nothing.
        """
        with self._asking:
            self._ours = self._lock() if self._ours is None else self._ours
        if not self._ours:
            why = "another gateway had this folder when this one started; give each a state.path of its own"
            raise ConfigError(f"{self.path}: {why}")

    def _lock(self) -> bool:
        """Return whether it is ours: also a missing folder, which its readers report, and one without locks."""
        try:
            fcntl.flock(os.open(self.path, os.O_RDONLY | os.O_CLOEXEC), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            return not isinstance(error, BlockingIOError)
        return True


class DiskWriter(Worker):
    """A worker that writes, and reports to the owner of the state. A hanging write delays only its own later ones."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop, owner: Ownership) -> None:
        super().__init__(name)
        self._loop = loop
        self._owner = owner

    def write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        """Queue `write` and return at once. `then` is called afterwards by the owner of the state.

        `then` receives None, or the text of the ConfigError that `write` raised.
        """
        self.do(lambda: self._write(write, then))

    def _write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        fault = None
        try:
            try:
                write()
            except ConfigError as error:
                fault = str(error)
            with self._owner:
                then(fault)
        except Exception as error:
            report_mistake(self._loop, f"the thread {self.thread.name} failed", error)


def report_mistake(loop: asyncio.AbstractEventLoop, what: str, error: Exception) -> None:
    """Report `error` to the loop's exception handler, which ends the service. May be called from any thread."""
    with suppress(RuntimeError):  # the loop is closed: the service has ended
        loop.call_soon_threadsafe(loop.call_exception_handler, {"message": what, "exception": error})
