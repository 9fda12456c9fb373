"""One leg: its servos, its rate slots, and who commands it. Pure."""

from dataclasses import dataclass

from gateway.model.frames import servo_ids_of
from gateway.robot.core.events import NOBODY, Sender
from gateway.robot.core.gates.rate import RateSlots
from gateway.robot.core.servo import OFF, RUNNING, Servo
from schemas.words import WatchdogState


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
