"""Which way a robot takes from one posture to another: the first of several plans that its legs can follow. Pure."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Final, NamedTuple

from gateway.errors import WalkError
from gateway.geometry.kinematics import Vector
from gateway.people.walking.gaits import TRIPODS
from gateway.people.walking.inverse import Angles
from gateway.people.walking.motion import Body
from gateway.people.walking.robot import LIFT_M, Pose, Robot, Stance
from gateway.people.walking.stability import MARGIN_M, centre_of_mass, margin_m
from gateway.people.walking.ways import ON_GROUND_M, Bend, Move, Shift, Step, lowered, shift, steps
from schemas.robot import LEGS

RAISED_M: Final = 0.02
"""How high the feet of a lying robot are when its legs are started: they push against nothing."""
_SAMPLES: Final = 8
"""Of a move, when a plan is tried."""
_SAME_DEG: Final = 2.0
"""By which a plan's first pose may differ from the present one: more, and the leg is bent the other way."""

Feet = Mapping[int, Vector]


class Start(NamedTuple):
    """How a robot was found, and the moves that bring its legs in order."""

    body: Body
    feet: Feet
    pose: Pose
    moves: tuple[Move, ...]
    sits: bool


class Planner:
    """Plans for one robot."""

    def __init__(self, robot: Robot) -> None:
        """Raises WalkError where it cannot sit."""
        self._robot = robot
        self._seat = robot.stance(Body(robot.lying_m), walks=False)
        feet = {leg: (x, y, RAISED_M) for leg, (x, y, _) in self._seat.feet.items()}
        self._rest = Start(self._seat.body, feet, self._placed(self._seat.body, feet), (), sits=True)

    def found(self, pose: Pose) -> Start:
        """`pose`: of the legs that run; the others are slack, and may be anywhere.

        The ground is where the lowest feet are, if they carry the robot. Else it lies on it.
        """
        if not pose:
            return self._rest
        robot, whole = self._robot, {**self._rest.pose, **pose}
        points = {leg: robot.foot_m(leg, angles) for leg, angles in whole.items()}
        body = Body(-min(point[2] for point in points.values()))
        turn = body.turn
        feet = {leg: body.grounded(point, turn) for leg, point in points.items()}
        stand = [leg for leg in LEGS if feet[leg][2] < ON_GROUND_M]
        above = len(pose) == len(LEGS) and body.height_m >= self._seat.body.height_m
        if above and balanced(robot, body, feet, whole, stand):
            return Start(body, feet, whole, (), sits=False)
        body = self._seat.body
        feet = {leg: body.grounded(point, turn) for leg, point in points.items()}
        return Start(body, feet, whole, tuple(self._folded(whole)), sits=True)

    def way(self, body: Body, feet: Feet, pose: Pose, stance: Stance | None) -> tuple[Move, ...]:
        """From there to a stance; None: to the seat."""
        goal = stance or self._seat
        for plan in self._plans(body, feet, pose, goal):
            if self._works(body, feet, pose, plan):
                return tuple(plan)
        # Down onto its belly, joint by joint, and up again from there.
        folded = list(self._folded(pose))
        rest = self._rest
        for plan in self._plans(rest.body, rest.feet, rest.pose, goal):
            if self._works(rest.body, rest.feet, rest.pose, plan):
                return (*folded, *plan)
        raise WalkError("it finds no way to stand up within its limits")

    # ---- the plans

    def _plans(self, body: Body, feet: Feet, pose: Pose, goal: Stance) -> Iterator[list[Move]]:
        """Feet that hang are lowered; then up or down to a height at which all can step, the steps, and the pose."""
        hanging = [leg for leg in LEGS if feet[leg][2] > 0.0]
        begin = [lowered(feet, hanging)] if hanging else []
        down = {leg: (x, y, 0.0) for leg, (x, y, _) in feet.items()}
        needed = list(steps(down, goal.feet))
        heights_m = (self._robot.usual_m, goal.body.height_m, body.height_m, (goal.body.height_m + body.height_m) / 2)
        for height_m in dict.fromkeys(heights_m):
            level = Body(height_m) if needed else goal.body
            yield [*begin, *shift(body, level), *needed, *shift(level, goal.body)]
        try:
            near = self._robot.stance(Body(body.height_m), walks=False)
        except WalkError:
            return
        bent = list(self._bent(pose, near))
        for height_m in dict.fromkeys(heights_m):
            level = Body(height_m)
            further = list(steps(near.feet, goal.feet))
            yield [*bent, *shift(near.body, level), *further, *shift(level, goal.body)]

    def _bent(self, pose: Pose, stance: Stance) -> Iterator[Move]:
        """Three legs at a time to a place above their feet's, joint by joint, and down."""
        above = {leg: (x, y, LIFT_M) for leg, (x, y, _) in stance.feet.items()}
        wanted = self._placed(stance.body, above)
        for tripod in TRIPODS:
            yield Bend({leg: (pose[leg], wanted[leg]) for leg in tripod})
            yield lowered(above, tripod)

    def _folded(self, pose: Pose) -> Iterator[Move]:
        """Three legs at a time to where a lying robot has them."""
        rest = self._rest.pose
        first, second = TRIPODS
        yield Bend({leg: (pose[leg], rest[leg]) for leg in first})
        yield Bend({leg: (pose[leg], rest[leg]) for leg in second}, then=self._rest.body)

    def _placed(self, body: Body, feet: Feet) -> dict[int, Angles]:
        turn = body.turn
        return {leg: self._robot.angles_deg(leg, body.seen(foot, turn)) for leg, foot in feet.items()}

    # ---- whether one works

    def _works(self, body: Body, feet: Feet, pose: Pose, plan: Sequence[Move]) -> bool:
        """Whether the legs can follow it, from the pose that they have, and the robot does not fall meanwhile."""
        feet, pose = dict(feet), dict(pose)
        try:
            for move in plan:
                body = self._tried(body, feet, pose, move)
        except WalkError:
            return False
        return True

    def _tried(self, body: Body, feet: dict[int, Vector], pose: dict[int, Angles], move: Move) -> Body:
        """The body after a move; `feet` and `pose` change to what they are then. Raises WalkError."""
        robot = self._robot
        if not isinstance(move, Shift):
            stand = [leg for leg in LEGS if leg not in move.paths and feet[leg][2] < ON_GROUND_M]
            if body.height_m > self._seat.body.height_m and not balanced(robot, body, feet, pose, stand):
                raise WalkError("it would fall")
        for sample in range(_SAMPLES + 1):
            part = sample / _SAMPLES
            if isinstance(move, Shift):
                body = move.at(part)
            elif isinstance(move, Step):
                feet.update({leg: move.at(leg, part) for leg in move.paths})
            else:
                pose.update({leg: move.at(leg, part) for leg in move.paths})
                turn = body.turn
                feet.update({leg: body.grounded(robot.foot_m(leg, pose[leg]), turn) for leg in move.paths})
                continue
            placed = self._placed(body, feet)
            if sample == 0 and _furthest(placed, pose) > _SAME_DEG:
                raise WalkError("a leg is bent the other way")
            pose.update(placed)
        return body


def balanced(robot: Robot, body: Body, feet: Feet, pose: Pose, stand: Iterable[int]) -> bool:
    """Whether the centre of mass is well inside the polygon of the feet that stand."""
    joints_rad = {leg: robot.joints_rad(leg, angles) for leg, angles in pose.items()}
    x, y, _ = centre_of_mass(robot, body, joints_rad)
    return margin_m((x, y), [feet[leg][:2] for leg in stand]) >= MARGIN_M


def _furthest(first: Pose, second: Pose) -> float:
    pairs = chain.from_iterable(zip(first[leg], second[leg], strict=True) for leg in first)
    return max(math.fabs(a - b) for a, b in pairs)
