"""The ways between postures: a sequence of moves, each smooth and without scraping feet. Pure."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

from gateway.geometry.kinematics import Vector
from gateway.people.walking.gaits import TRIPODS
from gateway.people.walking.inverse import Angles
from gateway.people.walking.motion import BodyPose
from gateway.people.walking.robot import LIFT_M, Robot
from schemas.robot import LEGS

LONGEST_S: Final = 30.0
"""Longer than any way to a posture, even with servos ten times slower than usual."""
STEP_S: Final = 0.5
"""The time of a foot's step to another place."""
_SINK_M_S: Final = 0.08
"""The body's highest mean speed up and down."""
_LEAN_RAD_S: Final = 0.4
_BEND_DEG_S: Final = 90.0
_LEAST_S: Final = 0.2
_UPRIGHT: Final = 0.15
CLIMB: Final = 0.4
"""The part of a swing in which a foot goes up, and in which it comes down again."""
_TURNING: Final = 0.05
ON_GROUND_M: Final = 0.004
"""A foot below this height stands."""
ALMOST: Final = 1e-9
_THERE_M: Final = 0.005
"""A foot that is nearer to its place need not step."""


class Shift(NamedTuple):
    """The body moves to another pose above standing feet."""

    begin: BodyPose
    end: BodyPose

    @property
    def seconds(self) -> float:
        rise_m, roll, pitch = (abs(b - a) for a, b in zip(self.begin, self.end, strict=True))
        return max(_LEAST_S, rise_m / _SINK_M_S, max(roll, pitch) / _LEAN_RAD_S)

    def put(self, figure: "Figure", robot: Robot, part: float) -> None:
        figure.body = BodyPose(*between(self.begin, self.end, smooth(part)))
        figure.place(robot, LEGS)


class Footsteps(NamedTuple):
    """Some feet step to other places together: at most three, unless the body lies on the ground."""

    paths: Mapping[int, tuple[Vector, Vector]]
    lift_m: float = LIFT_M
    seconds: float = STEP_S

    def put(self, figure: "Figure", robot: Robot, part: float) -> None:
        for leg, path in self.paths.items():
            x, y, z = between(*path, smooth(part))
            figure.feet[leg] = x, y, z + self.lift_m * 16.0 * (part * (1.0 - part)) ** 2
        figure.place(robot, self.paths)


class Bend(NamedTuple):
    """Some legs move from one pose to another, each servo straight to its angle."""

    paths: Mapping[int, tuple[Angles, Angles]]
    then: BodyPose | None = None
    """The body's pose after the move, if it is known only then."""

    @property
    def seconds(self) -> float:
        furthest = max(abs(b - a) for path in self.paths.values() for a, b in zip(*path, strict=True))
        return max(_LEAST_S, furthest / _BEND_DEG_S)

    def put(self, figure: "Figure", robot: Robot, part: float) -> None:
        figure.pose |= {leg: between(*path, smooth(part)) for leg, path in self.paths.items()}
        if part == 1.0 and self.then is not None:
            figure.body = self.then
        figure.ground(robot, LEGS)


Move = Shift | Footsteps | Bend
"""`put` puts a figure at a part (0 to 1) of the move. Raises WalkError if a leg does not reach."""


@dataclass(slots=True)
class Figure:
    """A robot's body, feet (in the ground frame) and joints (in degrees), and its moves to come."""

    body: BodyPose
    feet: dict[int, Vector]
    pose: dict[int, Angles]
    moves: tuple[Move, ...] = ()
    """The moves left on the way to another posture."""
    sits: bool = False
    """Whether the robot sits or lies after its moves."""

    def copy(self) -> Self:
        return replace(self, feet=dict(self.feet), pose=dict(self.pose))

    def ground(self, robot: Robot, legs: Iterable[int]) -> None:
        """Set the positions of these feet by the joints."""
        for leg in legs:
            self.feet[leg] = self.body.grounded(robot.foot_m(leg, self.pose[leg]))

    def place(self, robot: Robot, legs: Iterable[int]) -> None:
        """Set the joints for the positions of these feet. Raises WalkError if a leg does not reach."""
        for leg in legs:
            self.pose[leg] = robot.angles_deg(leg, self.body.seen(self.feet[leg]))


def steps(feet: Mapping[int, Vector], places: Mapping[int, Vector]) -> Iterator[Footsteps]:
    """Yield the steps of three feet at a time to their places. Feet that are there already stay."""
    for tripod in TRIPODS:
        paths = {
            leg: (feet[leg], places[leg])
            for leg in tripod
            if leg in feet and math.dist(feet[leg], places[leg]) > _THERE_M
        }
        if paths:
            yield Footsteps(paths)


def shift(begin: BodyPose, end: BodyPose) -> Iterator[Shift]:
    """Yield the shift of the body, if it is not there already."""
    if begin != end:
        yield Shift(begin, end)


# ---- smooth curves from 0 to 1


def smooth(part: float) -> float:
    """Rise from 0 to 1, without velocity or acceleration at either end."""
    return part**3 * (10.0 + part * (6.0 * part - 15.0))


def across(part: float) -> float:
    """Return how far a swing is from its lift-off to its landing, 0 to 1.

    At both ends the foot stays above one place: servos give way under load, and a low foot that moves would push the
    robot back. With 15 % of the swing at each end the simulated robot (tests/walking) goes as far as its steps; without
    these parts 7 to 13 % less.
    """
    return ease((part - _UPRIGHT) / (1.0 - 2.0 * _UPRIGHT))


def up(part: float, climb: float = CLIMB) -> float:
    """Return how high a stride's swing is, 0 to 1."""
    return ease(min(part, 1.0 - part) / climb)


def ease(part: float) -> float:
    """Rise from 0 to 1, without velocity at either end; less steep in the middle than `smooth`."""
    part = max(0.0, min(1.0, part))
    return part * part * (3.0 - 2.0 * part)


def outward(swing_s: float, stance_s: float) -> float:
    """Return by which factor a swing is wider than a stance: at its ends the foot moves with the ground."""
    return 1.0 + 2.0 * _UPRIGHT * swing_s / stance_s + _TURNING


def between(begin: Vector, end: Vector, part: float) -> Vector:
    """Return the point (or pose) on the straight line from `begin` (0) to `end` (1)."""
    (a, b, c), (d, e, f) = begin, end
    rest = 1.0 - part
    return a * rest + d * part, b * rest + e * part, c * rest + f * part


def lowered(feet: Mapping[int, Vector], legs: Iterable[int]) -> Footsteps:
    """Move those feet straight down to the ground."""
    return Footsteps(
        {leg: (feet[leg], (feet[leg][0], feet[leg][1], 0.0)) for leg in legs}, lift_m=0.0, seconds=STEP_S / 2
    )
