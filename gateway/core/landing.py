"""The way down of a robot that nobody commands any more: a straight line for each running servo. Pure.

This is motion that nobody asks for at that moment, so it is as narrow as can be: it goes from where the last frame left
a servo to the landing pose that a person has recorded, at an even pace, and ends at a time known when it begins.
Nothing may start a servo in it, turn it round, or make it longer.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol


class _Servo(Protocol):
    @property
    def servo_id(self) -> int: ...
    @property
    def angle_cdeg(self) -> int | None: ...


class Landing(NamedTuple):
    """A landing under way: for each running servo where it was and where it goes, in hundredths of a degree."""

    began_ns: int
    arrives_ns: int
    """From then on each servo is told its last angle; two rate slots before the end, so that a frame can say it."""
    ends_ns: int
    """When all six legs get their Stop, wherever they are."""
    ways_cdeg: Mapping[int, tuple[int, int]]

    def angle_cdeg(self, servo_id: int, now_ns: int) -> int:
        """Where the servo is to be now. It never lies outside the two ends of its way."""
        first, last = self.ways_cdeg[servo_id]
        if now_ns >= self.arrives_ns:
            return last
        return first + (last - first) * (now_ns - self.began_ns) // (self.arrives_ns - self.began_ns)

    def moves(self, servos: Iterable[_Servo]) -> bool:
        """Whether one of these servos runs and is not yet where it goes."""
        return any(
            servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos
        )


def landing(now_ns: int, ends_ns: int, period_ns: int, ways_cdeg: Mapping[int, tuple[int, int]]) -> Landing:
    """A landing that begins now. `period_ns` is a leg's rate slot; where there is time for few, all arrive at once."""
    return Landing(now_ns, max(now_ns, ends_ns - 2 * period_ns), ends_ns, ways_cdeg)
