"""Copies what precedes an incident out of the ring, so that nothing that comes later overwrites it.

A copy is a small ring beside the ring, in memory as well. Readers take from it what the ring no longer has.
"""

import logging
import os
from functools import partial
from pathlib import Path
from typing import Final

from gateway import durable
from gateway.host.worker import Worker
from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.model.black_box.header import COPIED_SHARE, MOST_COPIES, copies_of, copy_path
from gateway.model.black_box.incidents import FOLLOW_NS

CHUNK: Final = 4096
"""Records copied at a time: half a megabyte of memory."""
CLOSE_S: Final = 1.0
"""A copy of the largest ring takes some 10 ms."""

logger = logging.getLogger(__name__)


class IncidentCopies:
    """Decides which copies are made, and makes them on a thread of its own. A copy that fails stops nothing.

    A flood of emergency stops makes one copy: none follows another before servos have run, and none within FOLLOW_NS.
    """

    def __init__(self) -> None:
        self._ring: Path | None = None
        self._due = self._running = False
        self._ran = True
        """Whether servos ran since the latest copy."""
        self._copied_ns = -FOLLOW_NS

    def open(self, ring: Path) -> None:
        """The ring is open at this path, and has no other writer."""
        self._ring = ring
        self._worker = Worker("copy incident")

    def servos_run(self, running: bool) -> None:
        """Servos run from now on, or no longer."""
        self._running = running
        self._ran |= running

    def happened(self) -> None:
        """An incident begins, or goes on: what preceded this is to be copied, not now but behind its Stops."""
        self._due |= self._ran

    def look(self, now_ns: int, newest: int) -> None:
        """Have the newest records copied, up to this sequence number, if that is due. Returns at once."""
        if self._ring is not None and self._due and now_ns - self._copied_ns >= FOLLOW_NS:
            self._due, self._ran, self._copied_ns = False, self._running, now_ns
            self._worker.do(partial(_take, self._ring, newest))

    def close(self, newest: int) -> None:
        """Make a copy that is due, and wait for it, CLOSE_S at most."""
        if self._ring is not None:
            self.look(self._copied_ns + FOLLOW_NS, newest)
            self._worker.close(CLOSE_S)


def _take(ring: Path, newest: int) -> None:
    try:
        copy(ring, newest)
        for old in copies_of(ring)[:-MOST_COPIES]:
            old.unlink()
    except (OSError, form.DamagedRingError) as error:
        logger.warning("what precedes this incident is kept for a minute only: %s", error)


def copy(ring: Path, newest: int) -> None:
    """Copy the COPIED_SHARE of a ring's records up to `newest`. Raises OSError, DamagedRingError."""
    staged = durable.staged_for(ring)
    staged.unlink(missing_ok=True)  # of a process that was killed meanwhile
    with ring.open("rb") as source, durable.replacing(copy_path(ring, newest), staged):
        head = source.read(form.HEADER_BYTES)
        slots = header.slots_of(head, os.fstat(source.fileno()).st_size)
        count = max(1, slots // COPIED_SHARE)
        made = bytearray(header.new(count))
        header.put_calibration(made, header.calibration(head))
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(staged, flags, 0o600), "wb") as target:
            target.write(made)
            number = max(1, newest + 1 - count)
            while number <= newest:
                run = min(CHUNK, newest + 1 - number, slots - number % slots, count - number % count)
                target.seek(form.HEADER_BYTES + number % count * form.SLOT)
                target.write(os.pread(source.fileno(), run * form.SLOT, form.HEADER_BYTES + number % slots * form.SLOT))
                number += run
            target.truncate(header.file_bytes(count))
