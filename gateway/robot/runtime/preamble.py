"""Writes the bus's preamble in the pauses of a stream, in parts; the loop runs between the parts.

A preamble in parts delays a Stop by one part at most, and is complete before Stops are repeated. Without a pause, the
bus writes it ahead of a frame.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from gateway.errors import SpiError
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.spi.bus import Bus


@dataclass
class PreambleInPauses:
    """Schedules the parts. Call `arm` after each frame; `failed` is called with the fault of a part."""

    bus: Bus
    loop: asyncio.AbstractEventLoop
    owner: Ownership
    clock: Callable[[], int]
    failed: Callable[[SpiError], None]

    def __post_init__(self) -> None:
        self._timer = OwnersTimer(self.loop, self.owner, self._write_part)
        self._repeat_ns: int | None = None

    def arm(self, due_ns: int | None, repeat_ns: int | None) -> int | None:
        """Begin if a preamble is due, for a stream or for the Stops that are repeated at `repeat_ns`.

        Return when to call again (ns): the start of that preamble or `due_ns`, the earlier one.
        """
        self._repeat_ns = repeat_ns
        if not self._timer.armed and self._wanted():
            self._timer.set_in(0)  # on the loop, so that other owners get the state between two parts
        if repeat_ns is None or due_ns is None or self._timer.armed or self.bus.just_resynchronised:
            return due_ns
        return min(due_ns, repeat_ns - self.bus.preamble_ns)

    def cancel(self) -> None:
        self._timer.cancel()

    def _wanted(self) -> bool:
        if self.bus.resync_due:
            return True
        if self._repeat_ns is None or self.bus.just_resynchronised:
            return False
        return self.clock() >= self._repeat_ns - self.bus.preamble_ns

    def _write_part(self) -> None:
        if not self._wanted():
            return  # a frame was written meanwhile, with its preamble
        try:
            more = self.bus.write_zeros()
        except SpiError as fault:
            self.failed(fault)
            return
        if more:
            self._timer.set_in(0)
