"""A start waits until the power board has confirmed its power. Pure.

A command starts all its servos at once, or none.
"""

from collections.abc import Mapping

from gateway.robot.core.gates import NEVER
from gateway.robot.core.leg import Leg
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import OFF, WAITING, Servo


class PowerGate:
    """The servos that the power board has confirmed to power."""

    def __init__(self, rules: Rules, legs: Mapping[int, Leg]) -> None:
        self._legs = legs
        self.fed: frozenset[int] | None = frozenset() if rules.power else None
        """As of the board's latest news; None: there is no board."""

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
