"""Whether a robot falls: its centre of mass and the polygon of its standing feet. Pure.

The masses are assumptions (geometry/masses.py), each in the middle of its part.
"""

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Final

from gateway.geometry.kinematics import Vector, plus
from gateway.geometry.masses import MASSES, Masses
from gateway.people.walking.inverse import Angles
from gateway.people.walking.motion import BodyPose
from gateway.people.walking.robot import Robot
from gateway.people.walking.vectors import scaled

Point = tuple[float, float]

MARGIN_M: Final = 0.010
"""How far inside the polygon the centre of mass stays."""


def centre_of_mass(robot: Robot, body: BodyPose, joints_rad: Mapping[int, Angles], masses: Masses = MASSES) -> Vector:
    """The centre of mass in the ground frame, in metres."""
    mounts = [mount.xyz_m for mount in robot.geometry.leg_mounts.values()]
    low, high = (tuple(limit(axis) for axis in zip(*mounts, strict=True)) for limit in (min, max))
    moment = scaled(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2), masses.body_kg)
    for leg, angles in joints_rad.items():
        reach = robot.limbs[leg].forward(angles)
        for (begin, end), mass_kg in zip(pairwise((*reach.joints_m, reach.foot_m)), masses.links_kg, strict=True):
            moment = plus(moment, scaled(plus(begin, end), mass_kg / 2))
    total_kg = masses.body_kg + len(joints_rad) * sum(masses.links_kg)
    return body.grounded(scaled(moment, 1 / total_kg), body.turn)


def margin_m(point: Point, feet: Iterable[Point]) -> float:
    """How far `point` is inside the polygon of the feet; below 0: outside; minus infinity with fewer than three."""
    hull = _hull(sorted(set(feet)))
    if len(hull) < 3:
        return -math.inf
    return min(_left_of(begin, end, point) for begin, end in pairwise((*hull, hull[0])))


def _hull(points: list[Point]) -> list[Point]:
    """The convex hull, counter-clockwise (Andrew's monotone chain)."""

    def half(ordered: Iterable[Point]) -> list[Point]:
        chain: list[Point] = []
        for point in ordered:
            while len(chain) > 1 and _left_of(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return half(points) + half(reversed(points))


def _left_of(begin: Point, end: Point, point: Point) -> float:
    along = end[0] - begin[0], end[1] - begin[1]
    length = math.hypot(*along)
    return (along[0] * (point[1] - begin[1]) - along[1] * (point[0] - begin[0])) / length
