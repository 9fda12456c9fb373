"""The way down of a robot that nobody commands any more: a straight line for each running servo. Pure.

This is motion that nobody asks for at that moment, so it is as narrow as can be: it goes from where the last frame left
a servo to the landing pose that a person has recorded, at an even pace, and ends at a time known when it begins.
Nothing may start a servo in it, turn it round, or make it longer or faster.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from gateway.robot.core.leg import Servo


class Landing(NamedTuple):
    """A landing under way: for each running servo where it was and where it goes, in hundredths of a degree."""

    began_ns: int
    length_ns: int
    """How long the way takes. A landing that began in time arrives two rate slots before its end, so that a frame can
    state it."""
    period_ns: int
    """A rate slot: by more than this, no frame goes on."""
    ends_ns: int
    """When all six legs get their Stop, wherever they are."""
    ways_cdeg: Mapping[int, tuple[int, int]]

    def next_part_ns(self, part_ns: int, now_ns: int) -> int:
        """Return the part of the way (ns) for a leg's next frame, if its last frame was at `part_ns`.

        What a stall cost is not made up for: the servos would leap, and nobody has asked for any of this.
        """
        return min(now_ns - self.began_ns, part_ns + self.period_ns, self.length_ns)

    def angle_cdeg(self, servo_id: int, part_ns: int) -> int:
        """Where the servo is to be then. It never lies outside the two ends of its way."""
        first, last = self.ways_cdeg[servo_id]
        return first + (last - first) * part_ns // self.length_ns

    def moves(self, servos: Iterable[Servo]) -> bool:
        """Whether one of these servos runs and is not yet where it goes."""
        return any(
            servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos
        )


def landing(
    now_ns: int, ends_ns: int, landing_ns: int, period_ns: int, ways_cdeg: Mapping[int, tuple[int, int]]
) -> Landing:
    """A landing that begins now. `period_ns` is a leg's rate slot; in a short one, one frame goes all the way.

    One that begins late, since the machine stalled, is no faster than one of `landing_ns`: it is stopped on its way.
    """
    return Landing(now_ns, max(period_ns, landing_ns - 2 * period_ns), period_ns, ends_ns, ways_cdeg)
