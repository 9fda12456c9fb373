"""A simulated controller whose device fails when a test says so."""

import random
import time
from collections.abc import Callable

from gateway.errors import SpiError
from gateway.model.frames import Framing
from tests.support.controllers import Controller


class FaultyController(Controller):
    """Each fault lasts from when it is asked for; of a transfer that fails, the controller sees no byte."""

    def __init__(
        self,
        framing: Framing,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        spend: Callable[[float], None] = time.sleep,
    ) -> None:
        """`spend`: lets a failing transfer take so many seconds."""
        super().__init__(framing, clock=clock)
        self._spend = spend
        self._fails: Callable[[bytes], bool] = lambda _: False
        self._cost_ms = self._stall_ms = 0.0
        self._failing_transfers = 0
        self._failing_until_ns = clock()
        self.all_off_ns: int | None = None
        """When the last servo was off, since this was last None."""

    def fail_next(self, count: int) -> None:
        """Let the next `count` transfers raise SpiError."""
        self._failing_transfers = count

    def fail_for_ms(self, duration_ms: float) -> None:
        """Let every transfer raise SpiError for a while."""
        self._failing_until_ns = self._clock() + round(duration_ms * 1e6)

    def fail_where(self, fails: Callable[[bytes], bool], cost_ms: float = 0.0) -> None:
        """Let each transfer of which this is true raise SpiError, after so long."""
        self._fails, self._cost_ms = fails, cost_ms

    def fail_by_chance(self, share: float, seed: int, cost_ms: float = 0.0) -> None:
        """Let each transfer fail with this probability, after so long."""
        chance = random.Random(seed)  # noqa: S311  (faults, no secrets)
        self.fail_where(lambda _: chance.random() < share, cost_ms)

    def stall_once(self, cost_ms: float) -> None:
        """Let the next transfer take so long, and succeed."""
        self._stall_ms = cost_ms

    def take(self, data: bytes) -> None:
        if self._stall_ms:
            cost_ms, self._stall_ms = self._stall_ms, 0.0
            self._spend(cost_ms / 1000)
        if self._fails(data):
            self._spend(self._cost_ms / 1000)
            raise SpiError("the simulated SPI device failed a transfer")
        if self._failing_transfers > 0 or self._clock() < self._failing_until_ns:
            self._failing_transfers = max(0, self._failing_transfers - 1)
            raise SpiError("the simulated SPI device failed a transfer")
        super().take(data)
        if self.all_off_ns is None and not self.energised:
            self.all_off_ns = self._clock()
