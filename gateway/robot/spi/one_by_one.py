"""One call for each transfer, for a kernel that takes no lists of transfers.

This sleeps the pauses, and writes no body if the program was suspended for too long after its announcement.
"""

import time
from collections.abc import Callable
from typing import Final

from gateway.errors import SpiError
from gateway.robot.spi import Batch, SpiDevice

STALE_NS: Final = 500_000_000
"""Half of the 1000 ms after which the controller gives up a frame. The other half allows for delays between reading the
clock and the first bit on the wire."""


class OneByOne:
    """Writes batches to a device transfer by transfer."""

    def __init__(
        self,
        device: SpiDevice,
        clock: Callable[[], int] = time.monotonic_ns,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._device = device
        self._clock = clock
        self._pause = pause

    def transfer(self, batch: Batch) -> None:
        """Write transfer by transfer. Raises SpiError, also if the program was suspended within the batch."""
        written_ns = None
        for data, pause_us in batch:
            if written_ns is not None and self._clock() - written_ns > STALE_NS:
                raise SpiError("this program was suspended between the two transfers of a frame")
            written_ns = self._clock()
            self._device.transfer(((data, 0),))
            self._pause(pause_us / 1e6)
