"""The robot as a URDF: links and joints as boxes and spheres with the masses of model.py."""

import math
from typing import Final
from xml.etree import ElementTree as Xml

from gateway.geometry.kinematics import BASE, LINKS, Vector, from_rpy, joint_name, link_name, plus, rotated
from gateway.geometry.model import MASSES, MAX_SPEED_DEG_S, Geometry
from schemas.robot import JOINTS, LEGS

_LIMB_M: Final = 0.025
_FOOT_M: Final = 0.012
_TIP_M: Final = 0.005
"""Radius for collisions. With the larger drawn radius, the foot would roll 4 mm further each step."""
BODY_HEIGHT_M: Final = 0.05
_EFFORT_NM: Final = 1.0
"""Required by URDF, not used here."""
_COLOURS: Final = {
    "body": "0.25 0.27 0.30 1",
    "coxa": "0.55 0.57 0.60 1",
    "femur": "0.20 0.45 0.70 1",
    "tibia": "0.85 0.60 0.20 1",
    "foot": "0.15 0.15 0.15 1",
}


def urdf(geometry: Geometry) -> str:
    """Return the URDF. Joints are named as in joint states, links as the frames of `transforms`."""
    robot = Xml.Element("robot", name=geometry.name)
    for name, rgba in _COLOURS.items():
        Xml.SubElement(Xml.SubElement(robot, "material", name=name), "color", rgba=rgba)
    xs, ys, zs = zip(*(mount.xyz_m for mount in geometry.leg_mounts.values()), strict=True)
    middle_m = (max(xs) + min(xs)) / 2, (max(ys) + min(ys)) / 2, (max(zs) + min(zs)) / 2
    size_m = max(max(xs) - min(xs), _LIMB_M), max(max(ys) - min(ys), _LIMB_M), BODY_HEIGHT_M
    _box(_link(robot, BASE), "body", size_m, middle_m, (0.0, 0.0, 0.0), MASSES.body_kg)
    for leg in LEGS:
        _leg(robot, geometry, leg)
    Xml.indent(robot)
    return '<?xml version="1.0"?>\n' + Xml.tostring(robot, encoding="unicode") + "\n"


def _leg(robot: Xml.Element, geometry: Geometry, leg: int) -> None:
    mount = geometry.leg_mounts[leg]
    _, *ends = [part.origin_xyz_m for part in geometry.chain]
    parent = BASE
    parts = zip(JOINTS, geometry.joints, LINKS, ends, MASSES.links_kg, strict=True)
    for number, joint, link, end_m, mass_kg in parts:
        name = link_name(leg, link)
        _limb(_link(robot, name), link, end_m, mass_kg)
        element = Xml.SubElement(robot, "joint", name=joint_name(10 * leg + number), type="revolute")
        xyz_m, rpy_rad = joint.origin_xyz_m, joint.origin_rpy_rad
        if parent == BASE:
            xyz_m = plus(mount.xyz_m, rotated(from_rpy((0.0, 0.0, mount.yaw_rad)), xyz_m))
            rpy_rad = rpy_rad[0], rpy_rad[1], rpy_rad[2] + mount.yaw_rad  # yaw comes last, about the parent's z
        _place(element, xyz_m, rpy_rad, parent, name)
        Xml.SubElement(element, "axis", xyz=_numbers(*joint.axis))
        low, high, speed = map(str, (*joint.limits_rad, math.radians(MAX_SPEED_DEG_S)))
        Xml.SubElement(element, "limit", lower=low, upper=high, effort=str(_EFFORT_NM), velocity=speed)
        parent = name
    foot = link_name(leg, "foot")
    end = _link(robot, foot)
    for kind, radius_m in (("visual", _FOOT_M), ("collision", _TIP_M)):
        Xml.SubElement(_shape(end, kind, "foot", (0.0, 0.0, 0.0)), "sphere", radius=str(radius_m))
    element = Xml.SubElement(robot, "joint", name=f"{foot}_joint", type="fixed")
    _place(element, geometry.foot.origin_xyz_m, (0.0, 0.0, 0.0), parent, foot)


def _limb(link: Xml.Element, material: str, end_m: Vector, mass_kg: float) -> None:
    """Add a box from the frame's origin to the next joint, or the foot."""
    length_m = math.hypot(*end_m)
    rpy_rad = 0.0, -math.atan2(end_m[2], math.hypot(end_m[0], end_m[1])), math.atan2(end_m[1], end_m[0])
    middle_m = end_m[0] / 2, end_m[1] / 2, end_m[2] / 2
    _box(link, material, (max(length_m, _LIMB_M), _LIMB_M, _LIMB_M), middle_m, rpy_rad, mass_kg)


def _box(link: Xml.Element, material: str, size_m: Vector, middle_m: Vector, rpy_rad: Vector, mass_kg: float) -> None:
    """Add a box for drawing and collisions, with homogeneous mass."""
    for kind in ("visual", "collision"):
        Xml.SubElement(_shape(link, kind, material, middle_m, rpy_rad), "box", size=_numbers(*size_m))
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "origin", xyz=_numbers(*middle_m), rpy=_numbers(*rpy_rad))
    Xml.SubElement(inertial, "mass", value=_numbers(mass_kg))
    x, y, z = (mass_kg * side_m**2 / 12 for side_m in size_m)
    moments = {"ixx": y + z, "iyy": x + z, "izz": x + y, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
    Xml.SubElement(inertial, "inertia", {name: _numbers(value) for name, value in moments.items()})


def _link(robot: Xml.Element, name: str) -> Xml.Element:
    return Xml.SubElement(robot, "link", name=name)


def _shape(
    link: Xml.Element, kind: str, material: str, xyz_m: Vector, rpy_rad: Vector = (0.0, 0.0, 0.0)
) -> Xml.Element:
    shape = Xml.SubElement(link, kind)
    Xml.SubElement(shape, "origin", xyz=_numbers(*xyz_m), rpy=_numbers(*rpy_rad))
    if kind == "visual":
        Xml.SubElement(shape, "material", name=material)
    return Xml.SubElement(shape, "geometry")


def _place(joint: Xml.Element, xyz_m: Vector, rpy_rad: Vector, parent: str, child: str) -> None:
    Xml.SubElement(joint, "origin", xyz=_numbers(*xyz_m), rpy=_numbers(*rpy_rad))
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)
