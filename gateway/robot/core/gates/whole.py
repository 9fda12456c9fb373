"""A robot that only starts as a whole waits for its last leg's rate slot. Pure.

Between two frames of its start, only some servos would run, and the wire has no such state.
"""

from collections.abc import Mapping

from gateway.robot.core.leg import Leg
from gateway.robot.core.servo import Servo


class WholeGate:
    def __init__(self, legs: Mapping[int, Leg]) -> None:
        self._legs = legs

    def opens_ns(self, servo: Servo) -> int:  # noqa: ARG002
        return max(leg.slots.next_ns for leg in self._legs.values() if not leg.runs)
