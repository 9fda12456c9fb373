"""The way from one posture to another: the first of several plans that the legs can follow. Pure."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, pairwise, permutations
from typing import Final

from gateway.errors import WalkError
from gateway.geometry.kinematics import Vector, plus
from gateway.geometry.model import BODY_KG, LINKS_KG
from gateway.people.walking.gaits import TRIPODS
from gateway.people.walking.motion import BodyPose, scaled
from gateway.people.walking.robot import LIFT_M, Pose, Robot, Stance
from gateway.people.walking.transitions import ON_GROUND_M, Bend, Figure, Move, Shift, lowered, shift, steps
from schemas.robot import LEGS

Point = tuple[float, float]

MARGIN_M: Final = 0.010
"""How far inside the polygon the centre of mass stays."""
_ROUNDING_M: Final = 1e-9
ROUNDED_M: Final = 0.0001
"""The heights of standing feet differ by up to this, since angles are known to hundredths of a degree."""


def centre_of_mass(robot: Robot, body: BodyPose, pose: Pose) -> Vector:
    """Return the centre of mass in the ground frame (m)."""
    moment = scaled(robot.middle_m, BODY_KG)
    for leg, angles in pose.items():
        positions = robot.positions(leg, angles)
        for (begin, end), mass_kg in zip(pairwise((*positions.joints_m, positions.foot_m)), LINKS_KG, strict=True):
            moment = plus(moment, scaled(plus(begin, end), mass_kg / 2))
    total_kg = BODY_KG + len(pose) * sum(LINKS_KG)
    return body.grounded(scaled(moment, 1 / total_kg))


def margin_m(point: Point, feet: Iterable[Point]) -> float:
    """Return how far (m) `point` is inside the feet's polygon (below 0: outside; minus infinity below three feet)."""
    points = set(feet)
    if len(points) < 3:
        return -math.inf
    sides = (side for side in permutations(points, 2) if all(_left_of(*side, each) > -_ROUNDING_M for each in points))
    return min(_left_of(*side, point) for side in sides)


def _left_of(begin: Point, end: Point, point: Point) -> float:
    along = end[0] - begin[0], end[1] - begin[1]
    length = math.hypot(*along)
    return (along[0] * (point[1] - begin[1]) - along[1] * (point[0] - begin[0])) / length


RAISED_M: Final = 0.02
"""The height of a lying robot's feet when its legs start, so that the feet do not push against the ground."""
_SAMPLES: Final = 8
"""The samples of a move in the check of a plan."""
_SAME_DEG: Final = 2.0
"""How far a plan's first pose may differ from the present pose. Above it a leg is bent the other way."""


class Planner:
    """Plans motions for one robot's geometry and limits."""

    def __init__(self, robot: Robot) -> None:
        """Raises WalkError if the robot cannot sit."""
        self._robot = robot
        self._seat = robot.stance(BodyPose(robot.lying_m), walks=False)
        feet = {leg: (x, y, RAISED_M) for leg, (x, y, _) in self._seat.feet.items()}
        self._rest = Figure(self._seat.body, feet, {}, sits=True)
        self._rest.place(robot, LEGS)

    def found(self, pose: Pose) -> Figure:
        """Return the figure of a robot whose running legs have this `pose`, with the moves that order its legs.

        The other legs are slack and may be anywhere. If the lowest feet carry the robot, they stand; else it lies.
        """
        if not pose:
            return self._rest.copy()
        robot, whole = self._robot, {**self._rest.pose, **pose}
        lowest_m = min(robot.foot_m(leg, angles)[2] for leg, angles in whole.items())
        found = Figure(BodyPose(-lowest_m), {}, whole)
        found.ground(robot, LEGS)
        stand = [leg for leg in LEGS if found.feet[leg][2] < ON_GROUND_M]
        above = len(pose) == len(LEGS) and found.body.height_m >= self._seat.body.height_m
        if above and balanced(robot, found, stand):
            return found
        found = Figure(self._seat.body, {}, whole, tuple(self._folded(whole)), sits=True)
        found.ground(robot, LEGS)
        return found

    def way(self, begin: Figure, stance: Stance | None) -> tuple[Move, ...]:
        """Return the moves from `begin` to a stance (None: to the seat). Raises WalkError if there is no way."""
        goal = stance or self._seat
        # Straight there, or down onto its belly, joint by joint, and up again from there.
        for first, figure in (((), begin), (self._folded(begin.pose), self._rest)):
            for plan in self._plans(figure, goal):
                if self._works(figure, plan):
                    return (*first, *plan)
        raise WalkError("it finds no way to stand up within its limits")

    # ---- the plans

    def _plans(self, figure: Figure, goal: Stance) -> Iterator[list[Move]]:
        """Yield plans: lower hanging feet, go to a height at which all feet can step, step, and take the pose."""
        body, feet = figure.body, figure.feet
        hanging = [leg for leg in LEGS if feet[leg][2] > ROUNDED_M]
        begin = [lowered(feet, hanging)] if hanging else []
        down = {leg: (x, y, 0.0) for leg, (x, y, _) in feet.items()}
        needed = list(steps(down, goal.feet))
        heights_m = (self._robot.usual_m, goal.body.height_m, body.height_m, (goal.body.height_m + body.height_m) / 2)
        for height_m in dict.fromkeys(heights_m):
            level = BodyPose(height_m) if needed else goal.body
            yield [*begin, *shift(body, level), *needed, *shift(level, goal.body)]
        try:
            near = self._robot.stance(BodyPose(body.height_m), walks=False)
        except WalkError:
            return
        bent = list(self._bent(figure.pose, near))
        for height_m in dict.fromkeys(heights_m):
            level = BodyPose(height_m)
            further = list(steps(near.feet, goal.feet))
            yield [*bent, *shift(near.body, level), *further, *shift(level, goal.body)]

    def _bent(self, pose: Pose, stance: Stance) -> Iterator[Move]:
        """Yield moves, three legs at a time: joint by joint to above their places, and down."""
        above = {leg: (x, y, LIFT_M) for leg, (x, y, _) in stance.feet.items()}
        wanted = Figure(stance.body, above, {})
        wanted.place(self._robot, LEGS)
        for tripod in TRIPODS:
            yield Bend({leg: (pose[leg], wanted.pose[leg]) for leg in tripod})
            yield lowered(above, tripod)

    def _folded(self, pose: Pose) -> Iterator[Move]:
        """Yield moves, three legs at a time, to the pose of a lying robot."""
        for tripod, then in zip(TRIPODS, (None, self._rest.body), strict=True):
            yield Bend({leg: (pose[leg], self._rest.pose[leg]) for leg in tripod}, then)

    # ---- whether one works

    def _works(self, begin: Figure, plan: Sequence[Move]) -> bool:
        """Return whether the legs can follow the plan from their pose, and the robot does not fall."""
        figure = begin.copy()
        try:
            for move in plan:
                if not isinstance(move, Shift):
                    stand = [leg for leg in LEGS if leg not in move.paths and figure.feet[leg][2] < ON_GROUND_M]
                    above = figure.body.height_m > self._seat.body.height_m
                    if above and not balanced(self._robot, figure, stand):
                        return False
                pose = dict(figure.pose)
                move.put(figure, self._robot, 0.0)
                pairs = chain.from_iterable(zip(figure.pose[leg], pose[leg], strict=True) for leg in pose)
                if any(abs(now - then) > _SAME_DEG for now, then in pairs):
                    return False
                for sample in range(1, _SAMPLES + 1):
                    move.put(figure, self._robot, sample / _SAMPLES)
        except WalkError:
            return False
        return True


def lying_deg(robot: Robot) -> dict[int, float]:
    """Return each servo's angle (degrees) when the robot lies, feet 2 cm up. Raises WalkError if it cannot."""
    pose = Planner(robot).found({}).pose
    return {10 * leg + joint: round(deg, 2) for leg, degs in pose.items() for joint, deg in enumerate(degs, start=1)}


def balanced(robot: Robot, figure: Figure, stand: Iterable[int]) -> bool:
    """Return whether the centre of mass is at least MARGIN_M inside the polygon of the feet that stand."""
    x, y, _ = centre_of_mass(robot, figure.body, figure.pose)
    return margin_m((x, y), [figure.feet[leg][:2] for leg in stand]) >= MARGIN_M
