"""Inverse kinematics: joint angles for a foot position, for the chain of the geometry file. Pure.

A leg is a joint that turns about the mount's z axis, then two parallel joints across it. This shape has a solution in
closed form. The file's numbers differ a little from the shape (`1.5708` for a right angle), which leaves the foot a
little off. So the solution is computed again, for an aim that is moved by this difference.
"""

import cmath
import math
from typing import Final, NamedTuple

from gateway.errors import WalkError
from gateway.geometry import Geometry
from gateway.geometry.kinematics import Vector, about, from_rpy, plus, rotated, times
from gateway.people.walking.motion import scaled

Angles = tuple[float, float, float]
"""The angles of a leg's joints 1, 2 and 3; in radians here, in degrees for servos."""

_OFF: Final = 0.02
"""How far (radians) an axis may differ from the closed form's shape."""
_CLOSE_M: Final = 1e-9
_ITERATIONS: Final = 8
_PARALLEL: Final = 1e-12
"""Below this square of a distance (m²) the foot is on the first joint's axis, and any angle will do."""


class LegPositions(NamedTuple):
    """The positions of a leg's joints and foot, and the joints' axes, in the body's frame."""

    joints_m: tuple[Vector, ...]
    foot_m: Vector
    axes: tuple[Vector, ...]


class Limb:
    """One leg's chain of three joints."""

    def __init__(self, geometry: Geometry, leg: int) -> None:
        """Raises WalkError for a chain without the module's shape."""
        self.leg = leg
        mount = geometry.leg_mounts[leg]
        self._mount = mount.xyz_m, from_rpy((0.0, 0.0, mount.yaw_rad))
        self._joints = [(each.origin_xyz_m, from_rpy(each.origin_rpy_rad), each.axis) for each in geometry.joints]
        self._tip_m = geometry.foot.origin_xyz_m
        (low, high), _, (knee_low, knee_high) = (each.limits_rad for each in geometry.joints)
        self._middle_rad = (low + high) / 2
        # The leg as a turntable and two rods in a plane, whose points are complex numbers.
        straight = self.forward((0.0, 0.0, 0.0))
        self._first_m, self._second_m, third_m = straight.joints_m
        self._upright, self._across, three = straight.axes
        self._side = 1.0 if dot(self._across, three) > 0 else -1.0
        upright = abs(self._upright[2]) > math.cos(_OFF)
        across = abs(dot(self._upright, self._across)) < math.sin(_OFF)
        parallel = self._side * dot(self._across, three) > math.cos(_OFF)
        if not (upright and across and parallel):
            raise WalkError(
                f"leg {leg}: joint 1 must turn about the mount's z axis, and joints 2 and 3 about parallel axes "
                "across it; for another chain there is no walking"
            )
        along = cross(self._across, self._upright)
        self._along = scaled(along, 1 / math.sqrt(dot(along, along)))
        self._upward = cross(self._across, self._along)
        self._femur = self._in_plane(minus(third_m, self._second_m))
        self._tibia = self._in_plane(minus(straight.foot_m, third_m))
        self._aside_m = dot(minus(straight.foot_m, self._first_m), self._across)
        offset = cmath.phase(self._tibia / self._femur)
        self._bend = 1.0 if self._side * (knee_low + knee_high) / 2 + offset > 0 else -1.0

    def forward(self, joints_rad: Angles) -> LegPositions:
        """Return the positions of the joints and the foot in the body's frame. `joints_rad`: in radians."""
        at_m, turn = self._mount
        joints_m, axes = [], []
        for (origin_m, fixed, axis), angle in zip(self._joints, joints_rad, strict=True):
            at_m, turn = plus(at_m, rotated(turn, origin_m)), times(turn, fixed)
            joints_m.append(at_m)
            axes.append(rotated(turn, axis))
            turn = times(turn, about(axis, angle))
        return LegPositions(tuple(joints_m), plus(at_m, rotated(turn, self._tip_m)), tuple(axes))

    def inverse(self, foot_m: Vector) -> Angles:
        """Return the joint angles (radians) for this foot position. Raises WalkError if the leg does not reach it."""
        aim_m = foot_m
        for _ in range(_ITERATIONS):
            angles = self._guess(aim_m)
            off_m = minus(foot_m, self.forward(angles).foot_m)
            if max(map(abs, off_m)) < _CLOSE_M:
                break
            aim_m = plus(aim_m, off_m)
        return angles

    # ---- the closed form

    def _in_plane(self, vector: Vector) -> complex:
        return complex(dot(vector, self._along), dot(vector, self._upward))

    def _guess(self, foot_m: Vector) -> Angles:
        level = minus(foot_m, self._first_m)
        out = minus(level, scaled(self._upright, dot(level, self._upright)))
        square = dot(out, out)
        first = 0.0
        if square > _PARALLEL:
            aside = math.acos(max(-1.0, min(1.0, self._aside_m / math.sqrt(square))))
            bearing = math.atan2(dot(self._upright, cross(self._across, out)), dot(self._across, out))
            choices = (wrapped(bearing - aside), wrapped(bearing + aside))
            first = min(choices, key=lambda angle: abs(angle - self._middle_rad))
        straight = rotated(about(self._upright, -first), level)
        span = self._in_plane(minus(straight, minus(self._second_m, self._first_m)))
        femur_m, tibia_m = abs(self._femur), abs(self._tibia)
        distance_m = abs(span)
        cosine = (distance_m**2 - femur_m**2 - tibia_m**2) / (2 * femur_m * tibia_m)
        if not -1.0 - 1e-6 <= cosine <= 1.0 + 1e-6:
            raise WalkError(
                f"leg {self.leg} does not reach: its foot would be {distance_m:.3f} m from its second joint, and "
                f"{abs(femur_m - tibia_m):.3f} to {femur_m + tibia_m:.3f} m are possible"
            )
        knee = self._bend * math.acos(max(-1.0, min(1.0, cosine)))
        bent = knee - cmath.phase(self._tibia / self._femur)
        second = cmath.phase(span / (self._femur + self._tibia * cmath.exp(1j * bent))) if distance_m else 0.0
        return first, wrapped(second), wrapped(self._side * bent)


# ---- vectors and angles


def minus(first: Vector, second: Vector) -> Vector:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


def dot(first: Vector, second: Vector) -> float:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def cross(first: Vector, second: Vector) -> Vector:
    return (
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    )


def wrapped(angle: float) -> float:
    """Return the same angle (radians) between -pi and pi."""
    return math.remainder(angle, 2 * math.pi)
