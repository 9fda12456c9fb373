"""Writes the bus's preamble in the pauses of a stream: part by part, with the loop turning between them.

The bus would write it ahead of a frame. Here it delays no Stop that comes meanwhile by more than one part, and a
repeated run of Stops finds it written.
"""

import asyncio
from collections.abc import Callable

from gateway.errors import SpiError
from gateway.robot.host.ownership import Ownership, OwnersTimer
from gateway.robot.spi.bus import Bus


class PreambleInPauses:
    """Watches what is due; `arm` is to be called after each frame, and `failed` takes a part's fault."""

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
        """Begin, if a preamble is wanted now, for a stream or for the Stops that are repeated at `repeat_ns`.

        Returns when to call again at the latest: for the preamble ahead of those, or at `due_ns`.
        """
        self._repeat_ns = repeat_ns
        if not self._timer.armed and self._wanted():
            self._timer.set_in(0)  # on the loop, whose turns leave the state to others between two parts
        if repeat_ns is None or due_ns is None or self._timer.armed or self._bus.just_resynchronised:
            return due_ns
        return min(due_ns, repeat_ns - self._bus.preamble_ns)

    def cancel(self) -> None:
        """No more zeros."""
        self._timer.cancel()

    def _wanted(self) -> bool:
        if self._bus.resync_due:
            return True
        if self._repeat_ns is None or self._bus.just_resynchronised:
            return False
        return self._clock() >= self._repeat_ns - self._bus.preamble_ns

    def _write_part(self) -> None:
        if not self._wanted():
            return  # a frame that had to come behind it has written it
        try:
            more = self._bus.write_zeros()
        except SpiError as fault:
            self._failed(fault)
            return
        if more:
            self._timer.set_in(0)
