"""A simulated controller whose device fails, and whose wire loses bytes, when a test says so."""

import time
from collections.abc import Callable

from gateway.errors import SpiError
from gateway.robot.protocol.framing import Framing
from gateway.robot.spi.simulator import SimulatedController


class FaultyController(SimulatedController):
    """Each fault lasts from when it is asked for; of a transfer that fails, the controller sees no byte."""

    def __init__(self, framing: Framing, *, clock: Callable[[], int] = time.monotonic_ns) -> None:
        super().__init__(framing, clock=clock)
        self._failing_transfers = 0
        self._failing_until_ns = self._silent_until_ns = clock()
        self._bytes_to_take = self._bytes_to_lose = 0

    def fail_next(self, count: int) -> None:
        """Let the next `count` transfers raise SpiError."""
        self._failing_transfers = count

    def fail_for_ms(self, duration_ms: float) -> None:
        """Let every transfer raise SpiError for a while."""
        self._failing_until_ns = self._clock() + round(duration_ms * 1e6)

    def silent_for_ms(self, duration_ms: float) -> None:
        """Let the controller receive nothing for a while, although transfers succeed."""
        self._silent_until_ns = self._clock() + round(duration_ms * 1e6)

    def lose_bytes(self, count: int, *, behind: int = 0) -> None:
        """Lose `count` bytes on the wire, behind the next `behind`."""
        self._bytes_to_take, self._bytes_to_lose = behind, count

    def take(self, data: bytes) -> None:
        if self._failing_transfers > 0 or self._clock() < self._failing_until_ns:
            self._failing_transfers = max(0, self._failing_transfers - 1)
            raise SpiError("the simulated SPI device failed a transfer")
        super().take(data)

    def _receive(self, data: bytes, now_ns: int) -> None:
        taken = min(self._bytes_to_take, len(data))
        lost = min(self._bytes_to_lose, len(data) - taken)
        self._bytes_to_take -= taken
        self._bytes_to_lose -= lost
        if now_ns >= self._silent_until_ns:
            super()._receive(data[:taken] + data[taken + lost :], now_ns)
