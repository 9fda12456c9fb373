"""Forward kinematics: the pose of each part of each leg for given joint angles. Pure.

Frames are named `base`, and for each leg `leg_1_coxa`, `leg_1_femur`, `leg_1_tibia` and `leg_1_foot`; the URDF's links
have the same names. A frame's x points along its part.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from gateway.geometry.model import Geometry
from schemas.robot import JOINTS, LEGS

BASE: Final = "base"
BODY: Final = "base_inertia"
"""The frame of the body's mass, at the base: KDL supports no root link with a mass."""
LINKS: Final = ("coxa", "femur", "tibia")
"""Moved by joints 1, 2 and 3 of a leg."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w."""


class FramePose(NamedTuple):
    """A frame's pose in its parent's frame: metres, and a unit quaternion (x, y, z, w)."""

    parent: str
    child: str
    translation_m: Vector
    rotation: Quaternion


def joint_name(servo_id: int) -> str:
    """Return the name of a servo's joint in joint states and the URDF: `joint_32` of servo 32."""
    return f"joint_{servo_id}"


def link_name(leg: int, link: str) -> str:
    """Return a link's name in the URDF, such as `leg_3_femur`."""
    return f"leg_{leg}_{link}"


def transforms(geometry: Geometry, joints_rad: Mapping[int, float]) -> Iterator[FramePose]:
    """Yield each frame in its parent's, from the body outward. `joints_rad`: by servo id; a missing joint is at 0."""
    yield FramePose(BASE, BODY, _ORIGIN, _UNTURNED)
    for leg in LEGS:
        mount = geometry.leg_mounts[leg]
        at_m, base = mount.xyz_m, from_rpy((0.0, 0.0, mount.yaw_rad))
        parent = BASE
        for number, joint, link in zip(JOINTS, geometry.joints, LINKS, strict=True):
            joint_rotation = about(joint.axis, joints_rad.get(10 * leg + number, 0.0))
            origin_m = plus(at_m, rotated(base, joint.origin_xyz_m))
            rotation = times(times(base, from_rpy(joint.origin_rpy_rad)), joint_rotation)
            child = link_name(leg, link)
            yield FramePose(parent, child, origin_m, rotation)
            parent, at_m, base = child, _ORIGIN, _UNTURNED
        yield FramePose(parent, link_name(leg, "foot"), geometry.foot.origin_xyz_m, _UNTURNED)


# ---- vectors and rotations

_ORIGIN: Final[Vector] = (0.0, 0.0, 0.0)
_UNTURNED: Final[Quaternion] = (0.0, 0.0, 0.0, 1.0)


def plus(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def times(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the product of two rotations: `second` in the frame rotated by `first`."""
    x1, y1, z1, w1 = first
    x2, y2, z2, w2 = second
    return (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


def rotated(rotation: Quaternion, vector: Vector) -> Vector:
    """Return `vector` turned by the unit quaternion `rotation`."""
    (x, y, z, w), (a, b, c) = rotation, vector
    p, q, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p


def about(axis: Vector, angle_rad: float) -> Quaternion:
    """Return the rotation about a unit axis."""
    sine = math.sin(angle_rad / 2)
    return axis[0] * sine, axis[1] * sine, axis[2] * sine, math.cos(angle_rad / 2)


def from_rpy(rpy_rad: Vector) -> Quaternion:
    """Return the rotation of roll, pitch and yaw as in a URDF: about the parent's x, then y, then z."""
    roll, pitch, yaw = rpy_rad
    return times(times(about((0, 0, 1), yaw), about((0, 1, 0), pitch)), about((1, 0, 0), roll))
