"""A walking engine under test, with checks of what must hold after each tick."""

import copyreg
import math
from copy import deepcopy
from functools import cache
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import pytest

from gateway.people.walking.engine import Engine
from gateway.people.walking.gait_speed import SLEW_M_S2, SLEW_RAD_S2
from gateway.people.walking.motion import STILL, Odometry, Posture, Velocity
from gateway.people.walking.planning import MARGIN_M, centre_of_mass, margin_m
from gateway.people.walking.robot import Pose, Robot
from gateway.people.walking.transitions import ON_GROUND_M, Shift
from schemas.robot import LEGS

TICK_S: Final = 0.02
_ROUNDING: Final = 1e-6
_LOW_M: Final = 0.010
"""Servos give way under load, so a foot may touch the ground from here on."""
copyreg.pickle(MappingProxyType, lambda proxy: (MappingProxyType, (dict(proxy),)))  # so that a robot can be copied


def legs_that_carry(engine: Engine) -> frozenset[int]:
    """Return those whose feet are on the ground, and not about to leave it."""
    state = engine.state
    move = state.moves[0] if state.moves else None
    away = set(state.swings) | (set() if move is None or isinstance(move, Shift) else set(move.paths))
    low_m = ON_GROUND_M if state.sits else math.inf
    return frozenset(leg for leg in LEGS if leg not in away and state.feet[leg][2] < low_m)


class Walked:
    """An engine whose every tick is checked; without `checks_balance` it may stand as badly as it was found."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.robot: Robot = engine.robot
        self.pose: Pose = engine.pose
        self.checks_balance = True
        self.margin_m = math.inf
        self.velocity = STILL

    def tick(self, velocity: Velocity = STILL) -> None:
        before_feet, stood = dict(self.engine.state.feet), legs_that_carry(self.engine)
        before_ground = {leg: self._on_the_floor(leg) for leg in before_feet}
        walked = self.engine.posture in (Posture.STANDING, Posture.WALKING)
        after = self.engine.step(velocity, TICK_S)
        self._check_servos(after)
        if walked and self.engine.posture in (Posture.STANDING, Posture.WALKING):
            self._check_stance(before_feet, stood)
            for leg, (_, _, height_m) in before_feet.items():
                if self.engine.state.feet[leg][2] < height_m < _LOW_M:
                    moved_m = math.dist(before_ground[leg], self._on_the_floor(leg))
                    assert moved_m < 1e-9, "a foot that comes down moves over the ground"
            self._check_velocity()
        if self.checks_balance and self.engine.state.body.height_m > self.robot.lying_m + 0.001:
            self._check_balance()
        self.pose, self.velocity = after, self.engine.state.velocity

    def run(self, seconds: float, velocity: Velocity = STILL) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick(velocity)

    def until(self, posture: Posture, at_most_s: float) -> float:
        """Tick until it has that posture, and return how long that took."""
        for count in range(round(at_most_s / TICK_S) + 1):
            if self.engine.posture is posture:
                return count * TICK_S
            self.tick()
        raise AssertionError(f"after {at_most_s} s it is {self.engine.posture}, {self.engine.limit}")

    def copy(self) -> "Walked":
        return deepcopy(self, {id(self.robot): self.robot})

    def _on_the_floor(self, leg: int) -> tuple[float, float]:
        """Return where a foot is on a floor that does not move with the robot."""
        x, y, _ = self.engine.state.feet[leg]
        return self.engine.state.odometry.then(Odometry(x, y))[:2]

    def _check_servos(self, after: Pose) -> None:
        for leg, angles in after.items():
            for joint, (old, new) in enumerate(zip(self.pose.get(leg, angles), angles, strict=True), start=1):
                allowed = self.robot.ranges[10 * leg + joint]
                assert 0 <= new <= 180
                assert allowed.min_deg <= new <= allowed.max_deg
                most_deg = allowed.max_speed_deg_s * TICK_S + _ROUNDING
                assert abs(new - old) <= most_deg, f"servo {leg}{joint} is too fast"

    def _check_stance(self, before: dict[int, tuple[float, float, float]], stood: frozenset[int]) -> None:
        """Check that standing feet keep their places on the ground, so they move as one rigid body."""
        moved = [(before[leg], self.engine.state.feet[leg]) for leg in stood & legs_that_carry(self.engine)]
        assert all(old[2] == new[2] for old, new in moved)
        for (a, b), (c, d) in pairwise(moved):
            assert math.dist(b, d) == pytest.approx(math.dist(a, c), abs=1e-9), "two feet that stand went apart"

    def _check_velocity(self) -> None:
        old, new = self.velocity, self.engine.state.velocity
        gained = math.hypot(new.forward_m_s, new.left_m_s) - math.hypot(old.forward_m_s, old.left_m_s)
        assert gained <= SLEW_M_S2 * TICK_S + _ROUNDING
        assert abs(new.turn_rad_s) - abs(old.turn_rad_s) <= SLEW_RAD_S2 * TICK_S + _ROUNDING

    def _check_balance(self) -> None:
        engine = self.engine
        assert len(legs_that_carry(engine)) >= 3
        x, y, _ = centre_of_mass(self.robot, engine.state.body, engine.pose)
        margin = margin_m((x, y), [engine.state.feet[leg][:2] for leg in legs_that_carry(engine)])
        self.margin_m = min(self.margin_m, margin)
        assert margin >= MARGIN_M


def standing(robot: Robot, gait: str = "tripod") -> Walked:
    """Return one that has stood up from lying."""
    return _stood_up(robot, gait).copy()


@cache
def _stood_up(robot: Robot, gait: str) -> Walked:
    walked = Walked(Engine(robot, gait))
    walked.engine.stand()
    walked.until(Posture.STANDING, 6.0)
    return walked
