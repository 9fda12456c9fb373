"""Velocities over the ground, the body's pose above it, and the state of a walk. Pure.

The ground frame lies on the ground below the body and moves with the body: x forward, y left, z up. In this frame a
standing foot moves backward as the body moves forward.
"""

import cmath
import math
from enum import StrEnum
from typing import Final, NamedTuple, Self

from gateway.errors import WalkError
from gateway.geometry.kinematics import Quaternion, Vector, from_rpy, rotated
from gateway.people.numbers import plain


def scaled(vector: Vector, factor: float) -> Vector:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


ABSURD: Final = 10.0
"""In m/s or rad/s. No walking robot is so fast: a larger value is a mistake in units."""
_STRAIGHT: Final = 1e-9


class Velocity(NamedTuple):
    """The body's velocity over the ground, in its own frame."""

    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    turn_rad_s: float = 0.0
    """Counter-clockwise, seen from above."""

    @classmethod
    def checked(cls, forward_m_s: float, left_m_s: float, turn_rad_s: float) -> Self:
        """Return a program's velocity. Raises WalkError unless all are finite numbers up to ABSURD."""
        found = []
        for name, given in (("forward_m_s", forward_m_s), ("left_m_s", left_m_s), ("turn_rad_s", turn_rad_s)):
            value = plain(given)
            if value is None or not math.isfinite(value):
                raise WalkError(f"{name} is {given!r}; a velocity is a finite number")
            if abs(value) > ABSURD:
                raise WalkError(f"{name} is {value:g}; no walking robot does more than {ABSURD:g}")
            found.append(value)
        return cls(*found)

    @property
    def moves(self) -> bool:
        """Whether the velocity is not zero."""
        return any(self)

    def times(self, factor: float) -> "Velocity":
        """Return the velocity in the same direction, `factor` times as fast."""
        return Velocity(self.forward_m_s * factor, self.left_m_s * factor, self.turn_rad_s * factor)


STILL: Final = Velocity()


def travelled(velocity: Velocity, seconds: float) -> tuple[float, float, float]:
    """Return where the body is after this time, in its first ground frame: x and y (m), heading (rad)."""
    forward, left, turn = velocity
    heading = turn * seconds
    if abs(heading) < _STRAIGHT:
        return forward * seconds, left * seconds, heading
    sine, rest = math.sin(heading) / turn, (1 - math.cos(heading)) / turn
    return sine * forward - rest * left, rest * forward + sine * left, heading


def carried(point: Vector, velocity: Velocity, seconds: float) -> Vector:
    """Return where a point on the ground is in the ground frame after this time (below 0: before)."""
    x, y, heading = travelled(velocity, seconds)
    from_body = cmath.rect(1.0, -heading) * complex(point[0] - x, point[1] - y)
    return from_body.real, from_body.imag, point[2]


class Odometry(NamedTuple):
    """Where the steps have carried the body since the beginning. Slipping feet are not noticed."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    def then(self, further: "Odometry") -> "Odometry":
        """Return the odometry after `further`, which began here. @private"""
        way_m = cmath.rect(1.0, self.heading_rad) * complex(further.x_m, further.y_m)
        return Odometry(self.x_m + way_m.real, self.y_m + way_m.imag, self.heading_rad + further.heading_rad)


ORIGIN: Final = Odometry()


class BodyPose(NamedTuple):
    """The body's pose above the ground: how high its frame's origin is, and how it leans."""

    height_m: float
    roll_rad: float = 0.0
    """Lean to the right."""
    pitch_rad: float = 0.0
    """Lean forward, nose down."""

    @property
    def turn(self) -> Quaternion:
        """The rotation from the body's frame into the ground frame."""
        return from_rpy((self.roll_rad, self.pitch_rad, 0.0))

    def seen(self, point: Vector) -> Vector:
        """Return a point of the ground frame in the body's."""
        x, y, z, w = self.turn
        return rotated((-x, -y, -z, w), (point[0], point[1], point[2] - self.height_m))

    def grounded(self, point: Vector) -> Vector:
        """Return a point of the body's frame in the ground frame."""
        x, y, z = rotated(self.turn, point)
        return x, y, z + self.height_m


class Posture(StrEnum):
    """The robot's posture."""

    LYING = "lying"
    SITTING = "sitting"
    STANDING = "standing"
    WALKING = "walking"
    MOVING = "moving"
    HALTED = "halted"


DOWN: Final = (Posture.LYING, Posture.SITTING)


class WalkState(NamedTuple):
    """The state of a walk."""

    posture: Posture
    gait: str
    height_m: float
    commanded: Velocity
    """The requested velocity; 0 after `hold_s`."""
    scaled: Velocity
    """The velocity that the legs can reach: the same direction, slower because of `limit`."""
    limit: str
    odometry: Odometry
    """Where the steps have carried the body since the walk began."""
    lost: tuple[int, ...]
    """Legs that somebody else has stopped."""
    terrain: str = "level"
    """`adapt`: the robot walks by its sensors, if it has some."""
    tilt_deg: float | None = None
    """The body's tilt against the world's up, as measured; None: not measured."""
    carrying: tuple[bool, ...] | None = None
    """By leg (1 to 6), whether it carries, as measured; None: not measured."""
    corrected_deg: float = 0.0
    """The body's lean against its feet, which keeps it level."""
    hanging: tuple[int, ...] = ()
    """Legs that found no ground."""
