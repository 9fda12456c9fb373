"""One call for each transfer: for `spi.batch = false`, and for a kernel that takes no lists of transfers.

What a call for all would give, this makes up for: a lock keeps other programs' transfers out of a batch, the pauses
are slept here, and a body is not written when this program stood still for too long behind its announcement.
"""

import fcntl
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from gateway.errors import SpiError
from gateway.robot.spi import Batch, SpiDevice

STALE_NS: Final = 500_000_000
"""Half of the 1000 ms after which the controller gives up a frame that it awaits. The other half allows for delays
between the last look at the clock and the first bit on the wire."""
_PATIENCE_S: Final = 0.25
"""How long to wait for the bus lock, once. A batch takes some ms, on a busy machine some tens. A program that holds the
lock for longer hangs, and Stops do not wait for that."""
LOCK_PAUSE_S: Final = 0.000_2
_QUEUE, _BUS = 0, 1  # bytes of the device on which the locks lie; 2 and 3 are those of `gateway.robot.spi.outside`


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
        self._patience_s = _PATIENCE_S

    def transfer(self, batch: Batch) -> None:
        """Write transfer by transfer. Raises SpiError, also where the program stood still within the batch."""
        with self._bus_lock():
            written_ns = None
            for data, pause_us in batch:
                if written_ns is not None and self._clock() - written_ns > STALE_NS:
                    raise SpiError("this program stood still between two transfers that belong together")
                written_ns = self._clock()
                self._device.transfer(((data, 0),))
                self._pause(pause_us / 1e6)

    @contextmanager
    def _bus_lock(self) -> Iterator[None]:
        """No other program that writes one by one comes between.

        A Stop from `stop-servos` between an announcement and its body would be lost, and everything after it misread.
        These are record locks, which end with their process.
        """
        fd = self._device.fileno()
        # The next in line locks the queue while it waits, so a program that writes without a pause cannot keep the bus.
        queued = fd is not None and self._lock(fd, _QUEUE)
        held = fd is not None and self._lock(fd, _BUS)
        if fd is not None and queued:
            _unlock(fd, _QUEUE)
        try:
            yield
        finally:
            if fd is not None and held:
                _unlock(fd, _BUS)

    def _lock(self, fd: int, place: int) -> bool:
        """Wait for a lock, but not for long. False: not locked in time, and the batch is written all the same."""
        give_up_s = time.monotonic() + self._patience_s
        while True:
            try:
                fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            except (BlockingIOError, PermissionError):  # another program's batch is under way
                if time.monotonic() > give_up_s:
                    self._patience_s = 0.0
                    return False
                time.sleep(LOCK_PAUSE_S)
            except OSError:  # the device is going away, and the transfer will report it
                return False
            else:
                self._patience_s = _PATIENCE_S
                return True


def _unlock(fd: int, place: int) -> None:
    with suppress(OSError):
        fcntl.lockf(fd, fcntl.LOCK_UN, 1, place)
