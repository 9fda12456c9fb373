"""One leg: its servos, its rate slots, and who commands it. Pure."""

from dataclasses import dataclass, field
from typing import Final

from gateway.model.frames import servo_ids_of
from gateway.rate_limit import NS_PER_S
from gateway.robot.core.events import NOBODY, Sender
from gateway.robot.core.servo import OFF, RUNNING, Servo
from schemas.words import WatchdogState

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


@dataclass(slots=True, eq=False)
class Leg:  # mutants accepted (FalseWithTrue, Step, TrueWithFalse): set before it is read
    """Three servos, their rate slots, and when an accepted command last started or set one of them."""

    number: int
    servos: tuple[Servo, Servo, Servo]
    slots: RateSlots
    commanded_ns: int | None = None
    expired: bool = False
    sender: Sender = NOBODY
    """Who sent the latest accepted command; NOBODY once the gateway itself has stopped the leg."""
    unfed_ns: int | None = None
    """When one of its starts began to wait for power, or None; as of the last `Legs.plan`."""
    steady_for: Sender | None = None
    """The sender whose next angles need no rule but limits and rate slots; None: not known since `Legs.plan`."""

    def is_steady_for(self, sender: Sender) -> bool:
        """Return whether all its servos run for this sender, at any speed, and none has a way to go.

        If so, `steady_for` remembers it until the next `Legs.plan`.
        """
        steady = self.sender == sender and all(
            each.life is RUNNING and each.target is None and each.pace_cdeg_s is None and each.sender == sender
            for each in self.servos
        )
        self.steady_for = sender if steady else None
        return steady

    @property
    def runs(self) -> bool:
        """Whether one of its servos runs."""
        first, second, third = self.servos
        return first.life is RUNNING or second.life is RUNNING or third.life is RUNNING

    @property
    def armed(self) -> bool:
        """Whether one of its servos runs, or waits to be started."""
        first, second, third = self.servos
        return first.life is not OFF or second.life is not OFF or third.life is not OFF

    def deadline_ns(self, timeout_ns: int) -> int | None:
        """Return when the watchdog stops this leg, or None if the leg rests or only waits for power."""
        waits = self.unfed_ns is not None and not self.runs
        return self.commanded_ns + timeout_ns if self.commanded_ns is not None and self.armed and not waits else None

    @property
    def watchdog(self) -> WatchdogState:
        if self.expired:
            return WatchdogState.EXPIRED
        return WatchdogState.ARMED if self.armed else WatchdogState.IDLE


def leg_at_rest(number: int, period_ns: int) -> Leg:
    """Return a leg whose servos are off."""
    first, second, third = servo_ids_of(number)
    return Leg(number, (Servo(first), Servo(second), Servo(third)), RateSlots(period_ns))
