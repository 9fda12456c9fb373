"""The landing of a robot without commands: a straight line for each running servo. Pure.

No client commands this motion, so its limits are narrow. It leads from the servo's last frame to the recorded landing
pose, at constant speed, and its end is known from the beginning. Nothing may start a servo during a landing, reverse
the landing, or make it longer or faster.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from gateway.robot.core.leg import Servo


class Landing(NamedTuple):
    """A landing in progress."""

    began_ns: int
    ends_ns: int
    """When all six legs get their Stop, at any angle. A landing that begins late is stopped on its way."""
    length_ns: int
    """The motion's duration: in time, it arrives two rate slots before `ends_ns`. A short one takes one frame."""
    period_ns: int
    """A leg's rate slot: the most that one frame advances the landing."""
    ways_cdeg: Mapping[int, tuple[int, int]]
    """Begin and end of each running servo's motion, in hundredths of a degree."""

    def next_part_ns(self, part_ns: int, now_ns: int) -> int:
        """Return the time within the motion (ns) for a leg's next frame, if its last frame was at `part_ns`.

        Time lost in a stall is not made up for, since the servos would jump.
        """
        return min(now_ns - self.began_ns, part_ns + self.period_ns, self.length_ns)

    def angle_cdeg(self, servo_id: int, part_ns: int) -> int:
        """Return the servo's angle at `part_ns` of the motion, never beyond its two ends."""
        first, last = self.ways_cdeg[servo_id]
        return first + (last - first) * part_ns // self.length_ns

    def moves(self, servos: Iterable[Servo]) -> bool:
        """Return whether one of these servos runs and is not yet at its end."""
        return any(
            servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos
        )
