"""Inverse kinematics: joint angles for a foot position, for the chain of the geometry file. Pure.

A leg is a joint that turns about the mount's z axis, then two parallel joints across it. This shape has a solution in
closed form. The file's numbers differ a little from the shape (`1.5708` for a right angle), so Newton's method on the
exact chain finishes the solution.
"""

import cmath
import math
from dataclasses import dataclass
from typing import Final

from gateway.errors import WalkError
from gateway.geometry import Geometry
from gateway.geometry.kinematics import Vector, about, from_rpy, plus
from gateway.people.walking.motion import Matrix, apply, back, matrix, scaled

Angles = tuple[float, float, float]
"""The angles of a leg's joints 1, 2 and 3; in radians here, in degrees for servos."""

_OFF: Final = 0.02
"""How far (radians) an axis may differ from the closed form's shape. Newton's method corrects the difference."""
_CLOSE_M: Final = 1e-9
_ITERATIONS: Final = 8
_DAMPING: Final = 1e-10
_PARALLEL: Final = 1e-12
"""Below this square of a distance (m²) the foot is on the first joint's axis, and any angle will do."""


@dataclass(frozen=True, slots=True)
class LegPositions:
    """The positions of a leg's parts in the body's frame: for the foot, its derivative and the masses."""

    joints_m: tuple[Vector, Vector, Vector]
    foot_m: Vector
    axes: tuple[Vector, Vector, Vector]


class Limb:
    """One leg's chain of three joints."""

    def __init__(self, geometry: Geometry, leg: int) -> None:
        """Raises WalkError for a chain without the module's shape."""
        self.leg = leg
        mount = geometry.leg_mounts[leg]
        self._mount_m = mount.xyz_m
        self._mount_turn = matrix(from_rpy((0.0, 0.0, mount.yaw_rad)))
        self._origins_m = tuple(joint.origin_xyz_m for joint in geometry.joints)
        self._turns = tuple(matrix(from_rpy(joint.origin_rpy_rad)) for joint in geometry.joints)
        self._axes = tuple(joint.axis for joint in geometry.joints)
        self._tip_m = geometry.foot.origin_xyz_m
        self._limits_rad = tuple(joint.limits_rad for joint in geometry.joints)
        # The leg as a turntable and two rods in a plane, whose points are complex numbers.
        first, second, third = self._turns
        one = apply(first, self._axes[0])
        two = apply(second, self._axes[1])
        three = apply(second, apply(third, self._axes[2]))
        upright = abs(one[2]) > math.cos(_OFF)
        across = abs(dot(self._axes[0], two)) < math.sin(_OFF)
        side = 1.0 if dot(two, three) > 0 else -1.0
        parallel = side * dot(two, three) > math.cos(_OFF)
        if not (upright and across and parallel):
            raise WalkError(
                f"leg {leg}: joint 1 must turn about the mount's z axis, and joints 2 and 3 about parallel axes "
                "across it; for another chain there is no walking"
            )
        self._side = side
        other = (1.0, 0.0, 0.0) if abs(self._axes[1][0]) < 0.9 else (0.0, 1.0, 0.0)
        along = minus(other, scaled(self._axes[1], dot(other, self._axes[1])))
        self._along = scaled(along, 1 / math.sqrt(dot(along, along)))
        self._upward = cross(self._axes[1], self._along)
        self._femur = self._in_plane(self._origins_m[2])
        self._tibia = self._in_plane(apply(third, self._tip_m))
        self._aside_m = dot(self._origins_m[1], two) + dot(
            plus(self._origins_m[2], apply(third, self._tip_m)), self._axes[1]
        )
        self._across = two
        low, high = self._limits_rad[2]
        offset = cmath.phase(self._tibia / self._femur)
        self._bend = 1.0 if side * (low + high) / 2 + offset > 0 else -1.0

    def forward(self, joints_rad: Angles) -> LegPositions:
        """Return the positions of the joints and the foot in the body's frame. `joints_rad`: in radians."""
        turn, at_m = self._mount_turn, self._mount_m
        joints_m, axes = [], []
        for origin_m, fixed, axis, angle in zip(self._origins_m, self._turns, self._axes, joints_rad, strict=True):
            at_m = plus(at_m, apply(turn, origin_m))
            turn = product(turn, fixed)
            joints_m.append(at_m)
            axes.append(apply(turn, axis))
            turn = spun(turn, axis, angle)
        first, second, third = joints_m
        one, two, three = axes
        return LegPositions((first, second, third), plus(at_m, apply(turn, self._tip_m)), (one, two, three))

    def inverse(self, foot_m: Vector) -> Angles:
        """Return the joint angles (radians) for this foot position. Raises WalkError if the leg does not reach it."""
        angles = self._guess(foot_m)
        for _ in range(_ITERATIONS):
            positions = self.forward(angles)
            off_m = minus(foot_m, positions.foot_m)
            if max(map(abs, off_m)) < _CLOSE_M:
                break
            angles = _improved(angles, positions, off_m)
        return angles

    # ---- the closed form

    def _in_plane(self, vector: Vector) -> complex:
        return complex(dot(vector, self._along), dot(vector, self._upward))

    def _guess(self, foot_m: Vector) -> Angles:
        from_mount = back(self._mount_turn, minus(foot_m, self._mount_m))
        level = back(self._turns[0], minus(from_mount, self._origins_m[0]))
        axis = self._axes[0]
        up = dot(level, axis)
        out = minus(level, scaled(axis, up))
        square = dot(out, out)
        if square > _PARALLEL:
            aside = math.acos(max(-1.0, min(1.0, self._aside_m / math.sqrt(square))))
            bearing = math.atan2(dot(axis, cross(self._across, out)), dot(self._across, out))
            choices = (wrapped(bearing - aside), wrapped(bearing + aside))
            low, high = self._limits_rad[0]
            first = min(choices, key=lambda angle: abs(angle - (low + high) / 2))
        else:
            first = 0.0
        straight = apply(spun(_UNTURNED, axis, -first), level)
        span = self._in_plane(back(self._turns[1], minus(straight, self._origins_m[1])))
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


def _improved(angles: Angles, positions: LegPositions, off_m: Vector) -> Angles:
    """Return the angles after one step of Newton's method, slightly damped since a straight leg has no inverse."""
    one, two, three = (
        cross(axis, minus(positions.foot_m, joint_m))
        for axis, joint_m in zip(positions.axes, positions.joints_m, strict=True)
    )
    # The normal equations of J step = off, whose matrix is symmetric, by Cramer's rule.
    x = dot(one, one) + _DAMPING, dot(one, two), dot(one, three)
    y = x[1], dot(two, two) + _DAMPING, dot(two, three)
    z = x[2], y[2], dot(three, three) + _DAMPING
    right = dot(one, off_m), dot(two, off_m), dot(three, off_m)
    across = cross(y, z)
    steps = dot(right, across), dot(x, cross(right, z)), dot(x, cross(y, right))
    first, second, third = (angle + step / dot(x, across) for angle, step in zip(angles, steps, strict=True))
    return first, second, third


# ---- vectors and rotations

_UNTURNED: Final[Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


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


def product(first: Matrix, second: Matrix) -> Matrix:
    """Return the matrix product: `second` in the frame that `first` has rotated."""
    (a, b, c), (d, e, f), (g, h, i) = second
    (r, s, t), (u, v, w), (x, y, z) = first
    return (
        (r * a + s * d + t * g, r * b + s * e + t * h, r * c + s * f + t * i),
        (u * a + v * d + w * g, u * b + v * e + w * h, u * c + v * f + w * i),
        (x * a + y * d + z * g, x * b + y * e + z * h, x * c + y * f + z * i),
    )


def spun(first: Matrix, axis: Vector, angle: float) -> Matrix:
    """Return `first`, followed by a rotation (radians) about an axis of its frame. Most joints turn about z."""
    if axis != (0.0, 0.0, 1.0):
        return product(first, matrix(about(axis, angle)))
    cosine, sine = math.cos(angle), math.sin(angle)
    (a, b, c), (d, e, f), (g, h, i) = first
    return (
        (a * cosine + b * sine, b * cosine - a * sine, c),
        (d * cosine + e * sine, e * cosine - d * sine, f),
        (g * cosine + h * sine, h * cosine - g * sine, i),
    )


def wrapped(angle: float) -> float:
    """Return the same angle (radians) between -pi and pi."""
    return math.remainder(angle, 2 * math.pi)
