"""Decides when a leg's next frame may leave. Pure, in integer nanoseconds of the monotonic clock.

A leg gets one rate slot in each period. A command with a free slot leaves at once and uses it up. A command without
waits, and only the newest target of each servo is kept. Up to `BUCKET` unused slots are kept (a token bucket), so that
a stream at the limit's rate passes unchanged although its messages arrive early and late. Older slots are dropped.

Kept slots make no burst: two frames of a leg are at least a quarter of its period apart. So at most rate + 3 frames
leave in any second, and exactly the rate in the long run.

Stop frames need no slot.
"""

from dataclasses import dataclass, field
from typing import Final

from gateway.allowance import NS_PER_S
from gateway.model.frames import OP_SET, OP_START, STARTS, ServoOp

NEVER: Final = 2**63  # mutants accepted (Step): later than any time
"""Later than any time."""

BUCKET: Final = 3
"""At 50 Hz, Wi-Fi delivers a setpoint up to 15 ms early or late: up to 30 ms between two, which is one and a half
periods. Three slots cover two periods, since the frame itself uses one."""
SPACING_SHARE: Final = 4
"""The least time between two frames of a leg is its period divided by this."""


def merged(older: ServoOp, newer: ServoOp) -> ServoOp:
    """Return the newer target. A waiting start stays a start if only its angle changes."""
    if older.op is OP_START and newer.op is OP_SET:
        return STARTS[newer.angle_cdeg]
    return newer


@dataclass(slots=True)
class RateSlots:  # mutants accepted (Gt_GtE, Step): equal times; a clock begins at 0
    """The rate slots of one leg. Before the first frame, the bucket is full."""

    period_ns: int
    oldest_ns: int = -BUCKET * NS_PER_S  # the longest period is 1 s, and the clock begins at 0
    """When the oldest kept slot began, or the next one begins."""
    next_ns: int = 0
    """When the next frame may leave."""
    taken_ns: int = 0
    """When the latest frame left."""

    def wait_until(self, until_ns: int) -> None:
        """Let no frame leave before this time."""
        self.next_ns = until_ns if until_ns > self.next_ns else self.next_ns

    def take(self, now_ns: int) -> None:
        """Use up the oldest slot that the bucket holds, for a frame that leaves now."""
        kept_ns = now_ns - (BUCKET - 1) * self.period_ns
        self.oldest_ns = (self.oldest_ns if self.oldest_ns > kept_ns else kept_ns) + self.period_ns
        self.taken_ns = now_ns
        soonest_ns = now_ns - (-self.period_ns // SPACING_SHARE)  # rounded up: never closer
        self.next_ns = self.oldest_ns if self.oldest_ns > soonest_ns else soonest_ns


@dataclass(slots=True)
class StartQueue:  # mutants accepted (Step): a clock begins at 0
    """Legs that wait to be energised, in order, at least `pause_ns` apart (0: all at once).

    The starting current of eighteen servos at once can overload the supply.
    """

    pause_ns: int
    next_ns: int = 0
    legs: list[int] = field(default_factory=list)

    def passes(self, leg: int, slots: RateSlots, now_ns: int, starts: bool) -> bool:
        """Return whether a frame of `leg` may leave now. A start waits in the queue, and for its rate slot."""
        if not starts:
            self.leave(leg)
            return True
        if leg not in self.legs:  # a waiting leg keeps its place
            self.legs.append(leg)
        if self.legs[0] != leg or now_ns < self.next_ns or now_ns < slots.next_ns:
            return False
        self.leave(leg)
        self.next_ns = now_ns + self.pause_ns
        return True

    def leave(self, leg: int) -> None:
        """Remove `leg` from the queue, if it waits."""
        if leg in self.legs:
            self.legs.remove(leg)

    def due_ns(self, leg: int, slot_ns: int) -> int | None:
        """Return when a leg with its slot at `slot_ns` may send, or None if another leg precedes it."""
        if leg not in self.legs:
            return slot_ns
        return max(slot_ns, self.next_ns) if self.legs[0] == leg else None
