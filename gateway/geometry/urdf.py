"""The robot as a URDF: links and joints as boxes and spheres with the masses of model.py."""

import math
from collections.abc import Iterator
from itertools import chain
from typing import Final
from xml.etree import ElementTree as Xml

from gateway.geometry.kinematics import BASE, BODY, LINKS, Vector, from_rpy, joint_name, link_name, plus, rotated
from gateway.geometry.model import BODY_KG, LINKS_KG, MAX_SPEED_DEG_S, Geometry
from schemas.robot import JOINTS, LEGS

_LIMB_M: Final = 0.025
_FOOT_M: Final = 0.012
_FOOT_KG: Final = 0.001
"""Of the tibia's mass. Without a mass of its own, pybullet gives each foot 1 kg."""
_TIP_M: Final = 0.005
"""Radius for collisions. With the larger drawn radius, the foot would roll 4 mm further each step."""
BODY_HEIGHT_M: Final = 0.05
_EFFORT_NM: Final = 1.0
"""Required by URDF, not used here."""
_ZERO: Final = (0.0, 0.0, 0.0)
_COLOURS: Final = {
    "body": "0.25 0.27 0.30 1",
    "coxa": "0.55 0.57 0.60 1",
    "femur": "0.20 0.45 0.70 1",
    "tibia": "0.85 0.60 0.20 1",
    "foot": "0.15 0.15 0.15 1",
}


def urdf(geometry: Geometry) -> str:
    """Return the URDF. Joints are named as in joint states, links as the frames of `transforms`."""
    materials = (_tag("material", _tag("color", rgba=rgba), name=name) for name, rgba in _COLOURS.items())
    xs, ys, _ = zip(*(mount.xyz_m for mount in geometry.leg_mounts.values()), strict=True)
    size_m = max(max(xs) - min(xs), _LIMB_M), max(max(ys) - min(ys), _LIMB_M), BODY_HEIGHT_M
    body = _tag("link", *_box("body", size_m, geometry.middle_m, _ZERO, BODY_KG), name=BODY)
    fixed = _tag("joint", *_place(_ZERO, _ZERO, BASE, BODY), name=f"{BODY}_joint", type="fixed")
    legs = chain.from_iterable(_leg(geometry, leg) for leg in LEGS)
    robot = _tag("robot", *materials, _tag("link", name=BASE), body, fixed, *legs, name=geometry.name)
    Xml.indent(robot)
    return '<?xml version="1.0"?>\n' + Xml.tostring(robot, encoding="unicode") + "\n"


def _leg(geometry: Geometry, leg: int) -> Iterator[Xml.Element]:
    mount = geometry.leg_mounts[leg]
    _, *ends = [part.origin_xyz_m for part in geometry.chain]
    parent = BASE
    parts = zip(JOINTS, geometry.joints, LINKS, ends, LINKS_KG, strict=True)
    for number, joint, link, end_m, mass_kg in parts:
        name = link_name(leg, link)
        # A box from the frame's origin to the next joint, or the foot.
        size_m = max(math.hypot(*end_m), _LIMB_M), _LIMB_M, _LIMB_M
        turn_rad = 0.0, -math.atan2(end_m[2], math.hypot(end_m[0], end_m[1])), math.atan2(end_m[1], end_m[0])
        box = _box(
            link, size_m, (end_m[0] / 2, end_m[1] / 2, end_m[2] / 2), turn_rad, mass_kg - _FOOT_KG * (link == LINKS[-1])
        )
        yield _tag("link", *box, name=name)
        xyz_m, rpy_rad = joint.origin_xyz_m, joint.origin_rpy_rad
        if parent == BASE:
            xyz_m = plus(mount.xyz_m, rotated(from_rpy((0.0, 0.0, mount.yaw_rad)), xyz_m))
            rpy_rad = rpy_rad[0], rpy_rad[1], rpy_rad[2] + mount.yaw_rad  # yaw comes last, about the parent's z
        place, axis = _place(xyz_m, rpy_rad, parent, name), _tag("axis", xyz=_numbers(*joint.axis))
        low, high, speed = map(str, (*joint.limits_rad, math.radians(MAX_SPEED_DEG_S)))
        limit = _tag("limit", lower=low, upper=high, effort=str(_EFFORT_NM), velocity=speed)
        yield _tag("joint", *place, axis, limit, name=joint_name(10 * leg + number), type="revolute")
        parent = name
    foot, radii_m = link_name(leg, "foot"), {"visual": _FOOT_M, "collision": _TIP_M}
    shapes = (_shape(kind, "foot", _ZERO, _ZERO, _tag("sphere", radius=str(each))) for kind, each in radii_m.items())
    moment = _numbers(0.4 * _FOOT_KG * _FOOT_M**2)
    inertia = _tag("inertia", ixx=moment, iyy=moment, izz=moment, ixy="0", ixz="0", iyz="0")
    mass = _tag("inertial", _origin(_ZERO, _ZERO), _tag("mass", value=_numbers(_FOOT_KG)), inertia)
    yield _tag("link", mass, *shapes, name=foot)
    place = _place(geometry.foot.origin_xyz_m, _ZERO, parent, foot)
    yield _tag("joint", *place, name=f"{foot}_joint", type="fixed")


def _box(material: str, size_m: Vector, middle_m: Vector, rpy_rad: Vector, mass_kg: float) -> Iterator[Xml.Element]:
    """Yield the parts of a box for drawing and collisions, with homogeneous mass."""
    for kind in ("visual", "collision"):
        yield _shape(kind, material, middle_m, rpy_rad, _tag("box", size=_numbers(*size_m)))
    x, y, z = (mass_kg * side_m**2 / 12 for side_m in size_m)
    moments = {"ixx": y + z, "iyy": x + z, "izz": x + y, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
    inertia = _tag("inertia", **{name: _numbers(value) for name, value in moments.items()})
    yield _tag("inertial", _origin(middle_m, rpy_rad), _tag("mass", value=_numbers(mass_kg)), inertia)


def _shape(kind: str, material: str, xyz_m: Vector, rpy_rad: Vector, form: Xml.Element) -> Xml.Element:
    drawn = [_tag("material", name=material)] if kind == "visual" else []
    return _tag(kind, _origin(xyz_m, rpy_rad), *drawn, _tag("geometry", form))


def _place(xyz_m: Vector, rpy_rad: Vector, parent: str, child: str) -> tuple[Xml.Element, ...]:
    return _origin(xyz_m, rpy_rad), _tag("parent", link=parent), _tag("child", link=child)


def _origin(xyz_m: Vector, rpy_rad: Vector) -> Xml.Element:
    return _tag("origin", xyz=_numbers(*xyz_m), rpy=_numbers(*rpy_rad))


def _tag(tag: str, *children: Xml.Element, **attributes: str) -> Xml.Element:
    element = Xml.Element(tag, attributes)
    element.extend(children)
    return element


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)
