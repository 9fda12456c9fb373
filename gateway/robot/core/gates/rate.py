"""The rate slots of a leg: when its next frame may leave. Pure."""

from dataclasses import dataclass, field
from typing import Final

from gateway.rate_limit import NS_PER_S

BUCKET: Final = 3
"""At 50 Hz, Wi-Fi delivers a setpoint up to 15 ms early or late: up to 30 ms between two, which is one and a half
periods. Three slots cover two periods, since the frame itself uses one."""
SPACING_SHARE: Final = 4
"""The least time between two frames of a leg is its period divided by this."""


@dataclass(slots=True)
class RateSlots:  # mutants accepted (Gt_GtE, Step): equal times; a clock begins at 0
    """When a leg's next frame may leave, in integer ns of the monotonic clock. Before the first, the bucket is full.

    A leg gets one rate slot in each period. A command with a free slot leaves at once and uses it up. A command without
    waits, and only the newest target of each servo is kept. Up to `BUCKET` unused slots are kept (a token bucket), so
    that a stream at the limit's rate passes unchanged although its messages arrive early and late. Older slots are
    dropped.

    Kept slots make no burst: two frames of a leg are at least a quarter of its period apart. So at most rate + 3 frames
    leave in any second, and exactly the rate in the long run. Stop frames need no slot.
    """

    period_ns: int
    oldest_ns: int = -BUCKET * NS_PER_S  # the longest period is 1 s, and the clock begins at 0
    """When the oldest kept slot began, or the next one begins."""
    next_ns: int = 0
    """When the next frame may leave."""
    taken_ns: int = 0
    """When the latest frame left."""

    _kept_ns: int = field(init=False)
    _least_ns: int = field(init=False)

    def __post_init__(self) -> None:
        self._kept_ns = (BUCKET - 1) * self.period_ns
        self._least_ns = -(-self.period_ns // SPACING_SHARE)  # rounded up: never closer

    def take(self, now_ns: int) -> None:
        """Use up the oldest slot that the bucket holds, for a frame that leaves now."""
        oldest_ns, kept_ns = self.oldest_ns, now_ns - self._kept_ns
        soonest_ns = now_ns + self._least_ns
        self.oldest_ns = oldest_ns = (oldest_ns if oldest_ns > kept_ns else kept_ns) + self.period_ns
        self.taken_ns = now_ns
        self.next_ns = oldest_ns if oldest_ns > soonest_ns else soonest_ns
