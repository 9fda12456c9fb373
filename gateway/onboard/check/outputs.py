"""Whether the power board's output for a servo feeds it: then its current rises while the servo moves. Pure.

The board feeds only what was started. So where `power.servos` names another servo at that output, nothing moves.
"""

from collections.abc import Mapping
from typing import Final

from schemas.telemetry import Telemetry

LEAST_RISE_A: Final = 0.05
"""A servo at rest draws some 8 mA, one that moves at least 100: less shows nothing."""


class ServoCurrents:
    """The highest current under each name, at rest and from `moves` on, in A."""

    def __init__(self) -> None:
        """At rest."""
        self.rest: dict[str, float] = {}
        self.moving: dict[str, float] = {}
        self._seen = self.rest

    def moves(self) -> None:
        """The servo is started now."""
        self._seen = self.moving

    def take(self, telemetry: Telemetry) -> None:
        """What the board measured."""
        for name, servo in (telemetry.servos or {}).items():
            if servo.current_a is not None:
                self._seen[name] = max(servo.current_a, self._seen.get(name, 0.0))


def finding(servo_id: int, rest: Mapping[str, float], moving: Mapping[str, float]) -> str:
    """What the currents show of a servo that was moved, as a sentence."""
    name = str(servo_id)
    rise_a = moving.get(name, 0.0) - rest[name] if name in rest else 0.0
    if rise_a >= LEAST_RISE_A:
        return f"The power board's output for servo {servo_id} feeds it ({rise_a * 1000:.0f} mA more than at rest)."
    return (
        f"The power board has measured no current of servo {servo_id}: the output that power.servos gives to it feeds "
        "another servo, or none. If it did not move, see by the plugs which one it is, and exchange the two there."
    )
