"""Draws docs/robot.svg from the geometry: `python -m tests.support.robot_picture`.

From above: legs, servo ids, which way a larger angle turns a leg. From behind: which way it turns joints 2 and 3.
"""

import math
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Final

from gateway.geometry import load
from gateway.geometry.kinematics import LINKS, Vector, link_name, plus, rotated, times, transforms
from gateway.geometry.model import Geometry
from schemas.robot import JOINTS, LEGS

FILE: Final = Path(__file__).parents[2] / "docs" / "robot.svg"
WIDTH, HEIGHT = 940, 700
SCALE: Final = 560
"""Pixels for a metre."""
ABOVE: Final = (470.0, 275.0)
"""The body's middle, seen from above; forward is up."""
BEHIND: Final = (470.0, 575.0)
"""The body's middle, seen from behind; left is left."""
STANDING: Final = {1: 0.0, 2: math.radians(25), 3: math.radians(-100)}
"""Joint angles of the picture. Joint 1 stands at servo 90, straight outward."""
ARC_PX: Final = 34
SIDES: Final = ((3, "left"), (4, "right"))
"""The legs that are drawn from behind."""

Point = tuple[float, float]


def points_m(geometry: Geometry, leg: int) -> list[Vector]:
    """Joints 1, 2 and 3 and the foot, in the body's frame."""
    joints_rad = {10 * leg + joint: angle for joint, angle in STANDING.items()}
    at_m, turned, found = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), []
    names = [link_name(leg, link) for link in (*LINKS, "foot")]
    for step in transforms(geometry, joints_rad):
        if step.child in names:
            at_m = plus(at_m, rotated(turned, step.translation_m))
            turned = times(turned, step.rotation)
            found.append(at_m)
    return found


def above(point_m: Vector) -> Point:
    return ABOVE[0] - SCALE * point_m[1], ABOVE[1] - SCALE * point_m[0]


def behind(point_m: Vector) -> Point:
    return BEHIND[0] - SCALE * point_m[1], BEHIND[1] - SCALE * point_m[2]


def line(points: list[Point], style: str) -> str:
    return f'<polyline class="{style}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'


def text(point: Point, words: str, style: str = "", anchor: str = "middle") -> str:
    return f'<text class="{style}" x="{point[0]:.1f}" y="{point[1]:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def arc(centre: Point, middle_rad: float, clockwise: bool) -> str:
    """An arrow around a joint, as seen in the picture; `middle_rad` counts clockwise from the picture's right."""
    half = 0.6 if clockwise else -0.6
    ends = [
        (centre[0] + ARC_PX * math.cos(middle_rad + turn), centre[1] + ARC_PX * math.sin(middle_rad + turn))
        for turn in (-half, half)
    ]
    (x1, y1), (x2, y2) = ends
    return f'<path class="turn" d="M{x1:.1f},{y1:.1f} A{ARC_PX},{ARC_PX} 0 0 {int(clockwise)} {x2:.1f},{y2:.1f}"/>'


def toward(begin: Point, end: Point) -> float:
    return math.atan2(end[1] - begin[1], end[0] - begin[0])


def along(begin: Point, end: Point, distance_px: float) -> Point:
    angle = toward(begin, end)
    return end[0] + distance_px * math.cos(angle), end[1] + distance_px * math.sin(angle)


def from_above(geometry: Geometry) -> Iterator[str]:
    mounts = [above(geometry.leg_mounts[leg].xyz_m) for leg in (1, 2, 4, 6, 5, 3, 1)]
    yield line(mounts, "body")
    x, y = ABOVE
    yield f'<path class="forward" d="M{x:.0f},{y:.0f} l0,-44"/>'
    yield text((x, y + 20), "forward")
    for leg in LEGS:
        mount, second, third, foot = (above(point) for point in points_m(geometry, leg))
        yield line([mount, second, third, foot], "leg")
        for joint, place in zip(JOINTS, (mount, second, third), strict=True):
            yield f'<circle class="joint" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="4"/>'
            if joint > 1:
                yield text((place[0], place[1] - 8), f"{leg}{joint}", "small")
        yield text(along(foot, mount, 24), f"{leg}1", "small")
        yield text(along(mount, foot, 26), f"leg {leg}", "name")
        # Seen from above, a joint's positive angle turns counterclockwise.
        larger_is_clockwise = geometry.servos[10 * leg + 1].direction < 0
        yield arc(mount, toward(mount, foot) + (0.75 if larger_is_clockwise else -0.75), larger_is_clockwise)


def from_behind(geometry: Geometry) -> Iterator[str]:
    yield line([behind(geometry.leg_mounts[leg].xyz_m) for leg, _ in SIDES], "body")
    for leg, side in SIDES:
        points = [behind(point) for point in points_m(geometry, leg)]
        yield line(points, "leg")
        for place in points[:3]:
            yield f'<circle class="joint" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="4"/>'
        outward = -1 if side == "left" else 1
        for joint, begin, end in ((2, points[1], points[2]), (3, points[2], points[3])):
            servo = geometry.servos[10 * leg + joint]
            # A positive angle lifts. From behind that is clockwise on the left, and counterclockwise on the right.
            yield arc(begin, toward(begin, end), (servo.direction > 0) == (side == "left"))
        anchor = "end" if side == "left" else "start"
        femur, tibia = geometry.servos[10 * leg + 2], geometry.servos[10 * leg + 3]
        lifts = "up" if femur.direction > 0 else "down"
        beside = [str(each) for each in LEGS if geometry.leg_mounts[each].xyz_m[1] * outward < 0]
        words = (
            f"legs {', '.join(beside)} ({side})",
            f"joint 2: 90° level, larger turns {lifts}",
            f"joint 3: {tibia.zero_deg:g}° in line with joint 2,",
            "90° at a right angle,",
            f"larger bends it {'outward' if tibia.direction > 0 else 'inward'}",
        )
        for row, each in enumerate(words):
            place = (points[3][0] + outward * 24, BEHIND[1] + 28 + 18 * row)
            yield text(place, each, "name" if row == 0 else "", anchor)


STYLE: Final = """
svg { background: #ffffff; }
text { font: 13px system-ui, sans-serif; fill: #222222; }
.small { font-size: 12px; fill: #555555; }
.name { font-weight: 600; }
.body { fill: #eef1f4; stroke: #555555; stroke-width: 2; }
.leg { fill: none; stroke: #2b5d8a; stroke-width: 5; stroke-linecap: round; stroke-linejoin: round; }
.joint { fill: #ffffff; stroke: #2b5d8a; stroke-width: 2; }
.turn, .forward { fill: none; stroke: #b4471f; stroke-width: 2; marker-end: url(#tip); }
"""


def picture(geometry: Geometry) -> str:
    """The whole picture, as SVG."""
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        'role="img" aria-label="The robot from above and from behind: legs 1 to 6, servo ids, and which way they turn">'
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="6" markerHeight="6" orient="auto">'
        '<path d="M0,0 L10,5 L0,10 z" fill="#b4471f"/></marker></defs>'
        f"<style>{STYLE}</style>"
    )
    body = [
        text((20, 26), "From above", "name", "start"),
        text((20, 46), "Arrows: where a larger angle turns.", "", "start"),
        text((20, 64), "Joint 1: 90° straight outward.", "", "start"),
        *from_above(geometry),
        text((20, 520), "From behind", "name", "start"),
        *from_behind(geometry),
    ]
    return "\n".join([head, *body, "</svg>", ""])


if __name__ == "__main__":
    FILE.write_text(picture(load()))
