"""Walking by sensors, in virtual time: level, touchdown, an edge, a fall, and sensors that are wrong."""

import math
from collections.abc import Callable
from typing import Final

import pytest

from gateway.errors import WalkError
from gateway.geometry import load
from gateway.geometry.kinematics import from_rpy
from gateway.model.telemetry import report_of
from gateway.people.walking.balance import FALLEN_DEG, LEANS_RAD, ReceivedTelemetry, Senses
from gateway.people.walking.motion import STILL, Posture, Velocity
from gateway.people.walking.ride import Ride
from gateway.people.walking.robot import LIFT_M, Robot
from schemas.robot import LEGS
from schemas.telemetry import Telemetry
from tests.support.published import AT_REST, WALL
from tests.support.ridden import Ridden
from tests.support.walked import TICK_S, Walked, standing

ROBOT: Final = Robot(load())
AHEAD: Final = Velocity(0.06)


def telemetry(feet: list[float] | None = None, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> Telemetry:
    x, y, z, w = from_rpy((roll_rad, pitch_rad, 0.0))
    found = report_of(AT_REST._replace(orientation_wxyz=(w, x, y, z)), WALL, 0.0)
    return found.model_copy(update={"feet": feet and tuple(feet)})


class Ground:
    """A floor below an engine: `height_m` at a place, and a slope that leans the body; a foot presses with 1."""

    def __init__(self, walked: Walked, height_m: Callable[[int, float], float], pitch_rad: float = 0.0) -> None:
        self.engine = walked.engine
        self._height_m, self._pitch_rad = height_m, pitch_rad
        self.stuck: dict[int, float] = {}

    def read(self) -> Telemetry:
        engine = self.engine
        deep_m = [
            self._height_m(leg, engine.state.odometry.x_m + engine.state.feet[leg][0]) - engine.state.feet[leg][2]
            for leg in LEGS
        ]
        carried_m = sorted(deep_m)[-3] - 0.001  # the body sinks until three feet touch
        feet = [self.stuck.get(leg, float(depth > carried_m)) for leg, depth in zip(LEGS, deep_m, strict=True)]
        body = engine.state.body
        return telemetry(feet, body.roll_rad, body.pitch_rad + self._pitch_rad)

    def run(self, seconds: float, velocity: Velocity = STILL) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.engine.step(velocity, TICK_S, self.read())


def flat(_leg: int, _x_m: float) -> float:
    return 0.0


@pytest.mark.parametrize(("reads", "hangs"), [(0.0, True), (1.0, False)])
def test_a_sensor_that_becomes_stuck_ends_a_walk_at_worst(reads: float, hangs: bool) -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, flat)
    ground.run(3.0, AHEAD)
    ground.stuck[5] = reads
    ground.run(5.0, AHEAD)
    assert (5 in walked.engine.state.hanging) is hangs
    at_m = walked.engine.state.odometry.x_m
    ground.run(2.0, AHEAD)
    assert (walked.engine.state.odometry.x_m > at_m) != hangs


@pytest.mark.parametrize(
    ("reads", "sentence"),
    [
        (telemetry([1.0] * 6, roll_rad=1.2), "has fallen"),
        (telemetry([1.0] * 6, roll_rad=math.pi), "the body leans by 180 degrees: it has fallen"),
        (telemetry([0.0] * 6), "somebody has lifted it"),
    ],
)
def test_fallen_or_lifted_it_stands_still_until_its_driver_has_let_go(reads: Telemetry, sentence: str) -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, flat)
    ground.run(2.3, AHEAD)
    for _ in range(20):
        pose = walked.engine.step(AHEAD, TICK_S, reads)
    assert sentence in walked.engine.limit
    for _ in range(50):
        assert walked.engine.step(AHEAD, TICK_S, reads) == pose
    ground.run(2.0, AHEAD)
    assert walked.engine.posture is Posture.STANDING
    at = walked.engine.state.odometry
    ground.run(1.0, AHEAD)
    assert walked.engine.state.odometry == at
    ground.run(0.1)
    ground.run(2.0, AHEAD)
    assert walked.engine.state.odometry.x_m > at.x_m + 0.05


def test_feet_are_unloaded_by_a_belly_on_the_ground_and_by_no_hard_step() -> None:
    senses = Senses()
    for forces in ([1.0] * 6, [50.0] * 6, [1.0] * 6):  # a hard step, for a tick
        for _ in range(1 if forces[0] > 1.0 else 50):
            assert not senses.take(telemetry(forces), TICK_S).fault
    for _ in range(50):
        assert not senses.take(telemetry([0.0] * 6), TICK_S, stands=False).fault
    for _ in range(20):
        felt = senses.take(telemetry([0.0] * 6), TICK_S)
    assert "lifted" in felt.fault
    assert felt.carrying == (False,) * 6


def test_a_foot_on_a_stone_is_lifted_no_higher_than_its_disc_allows() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, _: 0.02 if leg in (1, 6) else 0.0)
    for _ in range(300):
        ground.run(TICK_S, AHEAD)
        assert max(foot[2] for foot in walked.engine.state.feet.values()) < LIFT_M + 0.002
    assert walked.engine.state.odometry.x_m > 0.2


def test_below_a_body_that_leans_feet_rest_further_out_and_keep_their_strides() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, flat, pitch_rad=math.radians(12.0))
    ground.run(8.0, AHEAD)
    engine = walked.engine
    assert math.degrees(engine.corrected_rad) > 10.0
    assert engine.state.velocity.forward_m_s == pytest.approx(AHEAD.forward_m_s)
    further_m = [math.hypot(*engine.state.feet[leg][:2]) - math.hypot(*engine.stance.feet[leg][:2]) for leg in LEGS]
    assert sum(further_m) / len(LEGS) > 0.04


def test_a_body_leans_no_further_than_the_strides_allow() -> None:
    walked = standing(ROBOT)
    ground, engine = Ground(walked, flat, pitch_rad=math.radians(20.0)), walked.engine
    for _ in range(300):
        ground.run(TICK_S, Velocity(0.3))
        assert "reach:" not in engine.limit, "it leans less instead"
    assert 10.0 < math.degrees(engine.corrected_rad) < math.degrees(LEANS_RAD) - 1.0
    assert engine.state.odometry.x_m > 0.7


@pytest.mark.parametrize("ahead_m", [0.05, -0.05])
def test_a_walk_begins_with_the_feet_that_are_furthest_behind(ahead_m: float) -> None:
    """Feet at the edge of their discs would let it go nowhere before they are lifted."""
    walked = standing(ROBOT)
    engine = walked.engine
    for leg in (2, 3, 6):
        x, y, z = engine.state.feet[leg]
        engine.state.feet[leg] = x - math.copysign(engine._within_m + 0.003, ahead_m), y, z
    engine.state.place(ROBOT, LEGS)
    ground = Ground(walked, flat)
    ground.run(1.0, Velocity(ahead_m))
    assert abs(engine.state.odometry.x_m) > 0.02


def test_an_orientation_that_is_none_levels_nothing() -> None:
    none = report_of(AT_REST._replace(orientation_wxyz=(0.0, 0.0, 0.0, 0.0)), WALL, 0.0)
    felt = Senses().take(none, TICK_S)
    assert (felt.roll_rad, felt.pitch_rad, felt.tilt_deg) == (None, None, None)
    felt = Senses().take(telemetry(pitch_rad=math.radians(FALLEN_DEG + 10)), TICK_S)
    assert (felt.pitch_rad, felt.carrying) == (None, None)
    assert felt.tilt_deg == pytest.approx(FALLEN_DEG + 10)


def test_a_ride_adapts_only_where_it_is_asked_to() -> None:
    leaning = telemetry([1.0] * 6, roll_rad=0.1)
    for terrain, tilt_deg in (("level", None), ("adapt", pytest.approx(math.degrees(0.1)))):
        ridden = Ridden(terrain=terrain)
        ridden.telemetry = leaning
        ridden.ride.stand(None, ridden.now_s)
        ridden.run(6.0)
        state = ridden.ride.state
        assert (state.terrain, state.tilt_deg) == (terrain, tilt_deg)
        assert state.carrying == (None if terrain == "level" else (True,) * 6)
        assert (state.corrected_deg != 0.0) == (terrain == "adapt")
    with pytest.raises(WalkError, match="there is no terrain 'moon'; there are level, adapt"):
        Ride(ROBOT, terrain="moon")
    with pytest.raises(ValueError, match="there is no gait"):
        Ride(ROBOT, "gallop")


def test_telemetry_counts_while_it_is_fresh() -> None:
    measured, late = ReceivedTelemetry(), telemetry().model_copy(update={"age_ms": 200.0})
    assert measured.fresh(0.0) is None
    measured.take(telemetry(), 1.0)
    assert measured.fresh(1.2) is not None
    assert measured.fresh(1.4) is None
    measured.take(late, 2.0)
    assert measured.fresh(2.05) is late
    assert measured.fresh(2.15) is None
