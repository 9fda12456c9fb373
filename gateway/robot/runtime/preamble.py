"""Writes the bus's preamble in the pauses of a stream, in parts, with the loop running between them.

Otherwise the bus writes it ahead of a frame. In parts it delays no Stop by more than one part, and is complete before
Stops are repeated.
"""

import asyncio
from collections.abc import Callable

from gateway.errors import SpiError
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.spi.bus import Bus


class PreambleInPauses:
    """Schedules the parts. Call `arm` after each frame; `failed` gets the fault of a part."""

    def __init__(
        self,
        bus: Bus,
        loop: asyncio.AbstractEventLoop,
        owner: Ownership,
        clock: Callable[[], int],
        failed: Callable[[SpiError], None],
    ) -> None:
        self._bus = bus
        self._clock = clock
        self._failed = failed
        self._timer = OwnersTimer(loop, owner, self._write_part)
        self._repeat_ns: int | None = None

    def arm(self, due_ns: int | None, repeat_ns: int | None) -> int | None:
        """Begin if a preamble is due, for a stream or for the Stops repeated at `repeat_ns`.

        Returns the time of the next call: when that preamble has to begin, or else `due_ns`.
        """
        self._repeat_ns = repeat_ns
        if not self._timer.armed and self._wanted():
            self._timer.set_in(0)  # on the loop, so that other owners get the state between two parts
        if repeat_ns is None or due_ns is None or self._timer.armed or self._bus.just_resynchronised:
            return due_ns
        return min(due_ns, repeat_ns - self._bus.preamble_ns)

    def cancel(self) -> None:
        self._timer.cancel()

    def _wanted(self) -> bool:
        if self._bus.resync_due:
            return True
        if self._repeat_ns is None or self._bus.just_resynchronised:
            return False
        return self._clock() >= self._repeat_ns - self._bus.preamble_ns

    def _write_part(self) -> None:
        if not self._wanted():
            return  # a frame has been written since, with its preamble
        try:
            more = self._bus.write_zeros()
        except SpiError as fault:
            self._failed(fault)
            return
        if more:
            self._timer.set_in(0)
