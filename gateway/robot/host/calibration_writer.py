"""Writes calibrations to the disk on a thread of its own: a disk may take seconds, and no Stop waits for one."""

import asyncio
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from gateway.errors import ConfigError
from gateway.robot.core.calibration import Calibration
from gateway.robot.host import calibration_file
from gateway.robot.host.ownership import Ownership
from gateway.robot.host.realtime import PAGE_PRIORITY, prefer_thread

Then = Callable[[str | None], None]
"""What the owner of the state is to do after a write; with a sentence, where the old calibration stays."""


class CalibrationWriter:
    """One file, and the thread that writes it. A write that never ends keeps its own caller waiting and nobody else."""

    def __init__(
        self,
        path: Path,
        loop: asyncio.AbstractEventLoop,
        owner: Ownership,
        write: Callable[[Path, Calibration], None] = calibration_file.write,
    ) -> None:
        self._path = path
        self._loop = loop
        self._owner = owner
        self._write = write
        self._work: queue.SimpleQueue[tuple[Calibration, Then]] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="keep calibration", daemon=True).start()

    def keep(self, calibration: Calibration, then: Then) -> None:
        """Write it, and then, as owner of the state, call `then`. Returns at once."""
        self._work.put((calibration, then))

    def _run(self) -> None:
        prefer_thread(PAGE_PRIORITY)
        while True:
            calibration, then = self._work.get()
            try:
                fault = self._written(calibration)
                with self._owner:
                    then(fault)
            except Exception as error:  # as if it had happened on the loop: a mistake of our own ends the service
                context = {"message": "the calibration could not be kept", "exception": error}
                with suppress(RuntimeError):  # the loop is closed: the service has ended
                    self._loop.call_soon_threadsafe(self._loop.call_exception_handler, context)

    def _written(self, calibration: Calibration) -> str | None:
        try:
            self._write(self._path, calibration)
        except ConfigError as error:
            return str(error)
        return None
