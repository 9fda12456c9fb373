"""When may a start leave? One class for each reason to wait, and `Gates`, which asks them all. Pure."""

from collections.abc import Mapping
from typing import Final

from gateway.robot.core.leg import Leg
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import OFF, WAITING, Servo

NEVER: Final = 2**63  # mutants accepted (Step): any that is later than all times
"""Later than any time."""


class BurstGate:
    """A start without `sent_ms` waits until `core/backlog.py` has judged the rhythm of its messages."""

    def __init__(self) -> None:
        self.judged_ns: dict[int, int] = {}
        """When each waiting start is judged, by servo; a released start is not in it."""

    def opens_ns(self, servo: Servo) -> int:  # mutants accepted (Step): long ago
        return self.judged_ns.get(servo.servo_id, 0)

    def holds(self, servo: Servo) -> bool:
        """Return whether this servo's start waits to be judged."""
        return servo.servo_id in self.judged_ns and servo.life is WAITING


class PowerGate:
    """A start waits until the power board has confirmed its power. A command starts all its servos at once, or none."""

    def __init__(self, rules: Rules, legs: Mapping[int, Leg]) -> None:
        self._legs = legs
        self.fed: frozenset[int] | None = frozenset() if rules.power else None
        """The servos that the board powers, as of its latest news; None: there is no board."""

    def opens_ns(self, servo: Servo) -> int:
        return NEVER if self.holds(servo) else 0  # mutants accepted (Step): any time that is over

    def holds(self, servo: Servo) -> bool:
        """Return whether this servo's start waits for power: its own, or that of another servo of its command."""
        if self.fed is None or servo.life is not WAITING:
            return False
        return any(
            each.life is WAITING and each.command is servo.command and each.servo_id not in self.fed
            for leg in self._legs.values()
            for each in leg.servos
        )

    def begin(self) -> None:
        """Begin a step: stopped servos have lost their power."""
        if self.fed:
            on = {each.servo_id for leg in self._legs.values() for each in leg.servos if each.life is not OFF}
            self.fed &= on


class Stagger:  # mutants accepted (Step): a clock begins at 0
    """Starts of two legs are a pause apart: the starting current of eighteen servos can overload the supply.

    Waiting legs start in the order of their numbers.
    """

    def __init__(self, pause_ns: int) -> None:
        self.pause_ns = pause_ns
        """0: all legs may start at once."""
        self.next_ns = 0
        """When the next leg may start."""

    def started(self, now_ns: int) -> None:
        self.next_ns = now_ns + self.pause_ns


class Gates:
    """All gates of a start. A running servo waits for its leg's rate slot alone."""

    def __init__(self, rules: Rules, legs: Mapping[int, Leg]) -> None:
        self.supply = PowerGate(rules, legs)
        self.stagger = Stagger(rules.start_pause_ns)
        self.burst = BurstGate()
        self._together = tuple(legs.values()) if rules.starts_whole else ()
        """Legs that only start together: each waits for the rate slots of all. Between two frames of a start, only some
        servos would run, and the wire has no such state."""

    def opens_ns(self, servo: Servo) -> int:
        """Return when this waiting servo may start, apart from its leg's rate slot (ns).

        NEVER: not until another event opens a gate.
        """
        slots_ns = [leg.slots.next_ns for leg in self._together if not leg.runs]
        return max(self.burst.opens_ns(servo), self.supply.opens_ns(servo), self.stagger.next_ns, *slots_ns)
