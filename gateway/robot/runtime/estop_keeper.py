"""Keeps the emergency stop in the state directory: after its Stops, on a thread of its own.

Only one write runs at a time. The next one writes the latest state, so an older state never follows a newer one.
"""

import asyncio
import logging
import threading
from contextlib import suppress
from datetime import UTC
from functools import partial
from typing import Final

from gateway.errors import ConfigError
from gateway.robot.core.events import Announce, EstopKept
from gateway.robot.host import estop_file
from gateway.robot.host.disk_writer import DiskWriter
from gateway.robot.host.estop_file import KeptEstop
from gateway.robot.host.ownership import OwnersTimer
from gateway.robot.host.state_folder import StateFolder
from gateway.robot.runtime.conductor import Conductor
from schemas.keys import ESTOP
from schemas.telemetry import Kind

READ_S: Final = 2.0
"""How long the start waits for the disk. A disk answers within milliseconds, a worn card within a second."""
PAUSE_S: Final = 0.1
"""The pause between two writes that change only the number: a flood of requests must not wear out the card."""
SLOW_S: Final = 5.0
"""A longer write counts as hanging and is reported. It takes milliseconds, on a worn card a second."""
RETRY_S: Final = 1.0
"""The pause between attempts after a failed write: a full disk may have space again."""
FLUSH_S: Final = 0.2
"""How long the end of the service waits for a write."""
_LOOK: Final = "make sure that nobody is in danger, then reset it"

logger = logging.getLogger(__name__)


class EstopKeeper:
    """Reads the emergency stop that an earlier run left, and writes each change. Without a folder it keeps nothing."""

    def __init__(self, conductor: Conductor, folder: StateFolder | None, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to read, on another thread, so that the first Stops do not wait for the disk."""
        self._conductor = conductor
        self._folder = folder
        self._wanted: KeptEstop | None = None
        self._written: KeptEstop | None = None
        self._writes = False
        self._unknown: str | None = None
        """Why an earlier run's emergency stop is not known, until a reset. None: it is known."""
        self._fault: str | None = None
        self._idle = threading.Event()
        self._idle.set()
        self._ending = False
        self._found: KeptEstop | None = None
        self._is_read = asyncio.Event()
        if folder is None:
            return
        self._next = OwnersTimer(loop, conductor.owner, self._write_next)
        late = partial(self._report, f"the disk has not answered for {SLOW_S:g} s")
        self._slow = OwnersTimer(loop, conductor.owner, late)
        self._disk = DiskWriter("keep estop", loop, conductor.owner)
        self._disk.write(partial(self._read, folder), lambda _: loop.call_soon_threadsafe(self._is_read.set))

    # ---- the start

    def _read(self, folder: StateFolder) -> None:
        try:
            folder.own()
            self._found = estop_file.read(folder.path)
        except ConfigError as error:
            self._found = estop_file.unknown(str(error))

    async def known(self) -> None:
        """Report the earlier run's emergency stop to the supervisor, before any command. Takes READ_S at most."""
        if self._folder is None:
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(self._is_read.wait(), READ_S)
        silent = f"{self._folder.path}: the disk has not answered for {READ_S:g} s"
        found = self._found or estop_file.unknown(silent)
        conductor = self._conductor
        with conductor.owner:
            if not conductor.supervisor.latch.number:  # else the source and the time are those of a newer one
                conductor.events.restore_estop(found.source)
                conductor.reports.estop_since = found.time
            self._unknown = found.fault
            self._written = None if found.fault else found
            conductor.on_latch = self._changed
            conductor.ask(EstopKept(found.number, found.engaged))
            self._show()

    def announce_start(self) -> None:
        """Publish that an earlier run's emergency stop is engaged, or that it counts as engaged."""
        if self._folder is None:
            logger.info(
                "an emergency stop and the calibration are kept in memory only, until this process ends (state.path)"
            )
            return
        found = self._written
        if self._unknown is not None:
            number = self._conductor.supervisor.latch.number
            what = f"emergency stop {number} is engaged, since it is not known what an earlier run has left"
            self._conductor.events.announce(Announce(Kind.ESTOP_KEPT, f"{what} ({self._unknown}); {_LOOK}", key=ESTOP))
        elif found is not None and found.engaged and found.time is not None:
            since = f"{found.time.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
            by = "" if found.source is None else f", by {found.source}"
            detail = f"emergency stop {found.number} of {since}{by} is still engaged; {_LOOK}"
            self._conductor.events.announce(Announce(Kind.ESTOP_KEPT, detail, key=ESTOP))

    # ---- what changes

    def _changed(self) -> None:
        """Have a new emergency stop (its Stops are written) or a reset written to the disk."""
        latch = self._conductor.supervisor.latch
        if latch.since_ns is None:
            self._unknown = None
            self._wanted = KeptEstop(latch.number)
            self._show()
        else:
            reports = self._conductor.reports
            self._wanted = KeptEstop(latch.number, True, self._conductor.events.estop_source, reports.estop_since)
        if self._wanted != self._written:
            self._idle.clear()
            if not (self._next.armed and _only_number(self._written, self._wanted)):
                self._write_next()

    def _write_next(self) -> None:
        wanted = self._wanted
        if self._writes or wanted is None or self._folder is None:
            return
        if wanted == self._written:
            self._idle.set()
            return
        self._writes = True
        self._slow.set_in(SLOW_S)
        self._disk.write(partial(_write, self._folder, wanted), partial(self._ended, wanted))

    def _ended(self, written: KeptEstop, fault: str | None) -> None:
        self._writes = False
        self._slow.cancel()
        self._report(fault)
        if fault is not None:
            self._idle.set()  # `flush` does not wait for the next attempt
            self._next.set_in(RETRY_S)
            return
        self._written = written
        self._next.set_in(PAUSE_S)
        if self._ending or self._wanted == written or not _only_number(written, self._wanted):
            self._write_next()

    def _report(self, fault: str | None) -> None:
        """Publish why the emergency stop, or its end, is not kept. None: it is kept."""
        before, self._fault = self._fault, fault
        if self._conductor.closed or before == fault:
            return
        self._show()
        if before is None:
            engaged = self._wanted is not None and self._wanted.engaged
            what = "the emergency stop" if engaged else "the end of the emergency stop"
            then = "may forget it" if engaged else "engages it again"
            detail = f"{what} is not kept, so a restart {then}: {fault}"
            self._conductor.events.announce(Announce(Kind.ESTOP_NOT_KEPT, detail, key=ESTOP))
        self._conductor.reports.publish()

    def _show(self) -> None:
        self._conductor.reports.estop_fault = self._fault or self._unknown

    # ---- the end

    def flush(self) -> None:
        """Wait until all is written, FLUSH_S at most. The caller must not own the state."""
        with self._conductor.owner:
            self._ending = True
            if not self._idle.is_set():
                self._write_next()
        self._idle.wait(FLUSH_S)


def _write(folder: StateFolder, kept: KeptEstop) -> None:
    folder.own()
    estop_file.write(folder.path, kept)


def _only_number(on_disk: KeptEstop | None, wanted: KeptEstop | None) -> bool:
    """Return whether an emergency stop is engaged both on the disk and now, so that only its number may differ."""
    return on_disk is not None and on_disk.engaged and wanted is not None and wanted.engaged
