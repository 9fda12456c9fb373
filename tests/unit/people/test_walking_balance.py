"""Walking by sensors, in virtual time: level, touchdown, an edge, a fall, and sensors that are wrong."""

import math
from collections.abc import Callable
from datetime import UTC, datetime
from statistics import median
from typing import Final

import pytest

from gateway.errors import WalkError
from gateway.geometry import load
from gateway.geometry.kinematics import Vector, from_rpy
from gateway.people.walking import STILL, Posture, Robot, Velocity, Walker
from gateway.people.walking.balance import FALLEN_DEG, LATE_S, LEANS_RAD, Lateness, ReceivedTelemetry, Senses
from gateway.people.walking.robot import LIFT_M
from schemas.robot import LEGS
from schemas.telemetry import Imu, Telemetry
from tests.support.walked import TICK_S, Walked, standing

ROBOT: Final = Robot(load())
AHEAD: Final = Velocity(0.06)
_NONE: Final[Vector] = (0.0, 0.0, 0.0)


def telemetry(feet: list[float] | None = None, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> Telemetry:
    x, y, z, w = from_rpy((roll_rad, pitch_rad, 0.0))
    imu = Imu(orientation_wxyz=(w, x, y, z), angular_velocity_rad_s=_NONE, linear_acceleration_m_s2=_NONE)
    forces = None if feet is None else (feet[0], feet[1], feet[2], feet[3], feet[4], feet[5])
    return Telemetry(time=datetime(2026, 1, 1, tzinfo=UTC), age_ms=0.0, imu=imu, feet=forces)


class Ground:
    """A floor below an engine: `height_m` at a place, and a slope that leans the body; a foot presses with 1."""

    def __init__(
        self, walked: Walked, height_m: Callable[[int, float], float], roll_rad: float = 0.0, pitch_rad: float = 0.0
    ) -> None:
        self.engine = walked.engine
        self._height_m, self._slope = height_m, (roll_rad, pitch_rad)
        self.stuck: dict[int, float] = {}

    def read(self) -> Telemetry:
        engine = self.engine
        deep_m = [self._height_m(leg, engine.odometry.x_m + engine.feet[leg][0]) - engine.feet[leg][2] for leg in LEGS]
        carried_m = sorted(deep_m)[-3] - 0.001  # the body sinks until three feet touch
        feet = [self.stuck.get(leg, float(depth > carried_m)) for leg, depth in zip(LEGS, deep_m, strict=True)]
        body = engine.body
        return telemetry(feet, body.roll_rad + self._slope[0], body.pitch_rad + self._slope[1])

    def run(self, seconds: float, velocity: Velocity = STILL) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.engine.step(velocity, TICK_S, self.read())


def flat(_leg: int, _x_m: float) -> float:
    return 0.0


def test_on_a_flat_floor_it_walks_nearly_as_far_as_without_sensors() -> None:
    """A contact is read a tick after the pose in which the foot came down."""
    blind, feels = standing(ROBOT), standing(ROBOT)
    ground = Ground(feels, flat)
    for _ in range(300):
        blind.engine.step(AHEAD, TICK_S)
        ground.run(TICK_S, AHEAD)
        assert all(feels.engine.feet[leg][2] == pytest.approx(0.0, abs=0.001) for leg in feels.engine.standing)
    assert feels.engine.odometry.x_m > 0.9 * blind.engine.odometry.x_m


def test_without_telemetry_it_goes_on_from_where_it_is_as_it_always_did() -> None:
    blind, feels = standing(ROBOT), standing(ROBOT)
    feels.engine.step(STILL, TICK_S, telemetry())
    for _ in range(200):
        assert feels.engine.step(AHEAD, TICK_S) == blind.engine.step(AHEAD, TICK_S)


@pytest.mark.parametrize(("roll_rad", "pitch_rad"), [(0.1, 0.0), (0.0, -0.12), (-0.08, 0.08)])
def test_on_a_slope_the_body_becomes_level_at_a_bounded_rate(roll_rad: float, pitch_rad: float) -> None:
    ground = Ground(standing(ROBOT), flat, roll_rad, pitch_rad)
    before = ground.engine.body
    ground.run(TICK_S)
    first = ground.engine.body
    assert 0 < math.dist(before[1:], first[1:]) <= 0.2 * TICK_S * math.sqrt(2)
    ground.run(4.0)
    body = ground.engine.body
    assert body.roll_rad == pytest.approx(-roll_rad, abs=0.005)
    assert body.pitch_rad == pytest.approx(-pitch_rad, abs=0.005)


def test_beyond_its_bound_it_stays_as_level_as_it_may_and_its_state_has_the_tilt() -> None:
    ground = Ground(standing(ROBOT), flat, 0.0, math.radians(25.0))
    ground.run(8.0)
    assert abs(ground.engine.body.pitch_rad) <= LEANS_RAD + 1e-9
    assert ground.engine.posture is Posture.STANDING
    assert ground.engine.felt.tilt_deg == pytest.approx(25.0 + math.degrees(ground.engine.body.pitch_rad), abs=0.5)


def test_a_foot_that_meets_a_stone_stays_on_it() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, x_m: 0.02 if leg == 3 and x_m > 0.02 else 0.0)
    on_it = []
    for _ in range(250):
        ground.run(TICK_S, AHEAD)
        if 3 in walked.engine.standing:
            on_it.append(walked.engine.feet[3][2])
    assert max(on_it) > 0.012
    assert walked.engine.odometry.x_m > 0.2


def test_a_foot_goes_on_down_into_a_hole() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, x_m: -0.015 if leg == 4 and x_m > 0.02 else 0.0)
    low = []
    for _ in range(300):
        ground.run(TICK_S, AHEAD)
        if 4 in walked.engine.standing:
            low.append(walked.engine.feet[4][2])
    assert min(low) < -0.01
    assert not walked.engine.hanging


def test_over_an_edge_it_stands_still_says_which_foot_hangs_and_goes_back() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda _, x_m: -1.0 if x_m > walked.engine.stance.feet[1][0] + 0.1 else 0.0)
    ground.run(8.0, AHEAD)
    engine = walked.engine
    assert engine.hanging & {1, 2}
    assert "no ground under leg" in engine.limit
    assert engine.posture is Posture.STANDING
    at_m = engine.odometry.x_m
    assert at_m < 0.2
    ground.run(1.0, AHEAD)
    assert engine.odometry.x_m == at_m
    ground.run(6.0, AHEAD.times(-1.0))
    assert engine.odometry.x_m < at_m - 0.15
    assert not engine.hanging


@pytest.mark.parametrize("reads", [0.0, 1.0])
def test_a_sensor_that_is_stuck_from_the_beginning_is_not_believed(reads: float) -> None:
    blind, feels = standing(ROBOT), standing(ROBOT)
    ground = Ground(feels, flat)
    ground.stuck[2] = reads
    for _ in range(300):
        blind.engine.step(AHEAD, TICK_S)
        ground.run(TICK_S, AHEAD)
    assert feels.engine.odometry == pytest.approx(blind.engine.odometry, abs=1e-6)
    assert not feels.engine.hanging


@pytest.mark.parametrize(("reads", "hangs"), [(0.0, True), (1.0, False)])
def test_a_sensor_that_becomes_stuck_ends_a_walk_at_worst(reads: float, hangs: bool) -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, flat)
    ground.run(3.0, AHEAD)
    ground.stuck[5] = reads
    ground.run(5.0, AHEAD)
    assert (5 in walked.engine.hanging) is hangs
    at_m = walked.engine.odometry.x_m
    ground.run(2.0, AHEAD)
    assert (walked.engine.odometry.x_m > at_m) != hangs


def test_sensors_that_are_a_tenth_of_a_second_late_only_slow_it_down_on_a_flat_floor() -> None:
    assert LATE_S > 0.1
    blind, feels = standing(ROBOT), standing(ROBOT)
    ground, kept = Ground(feels, flat), [telemetry([1.0] * 6)] * 5
    for _ in range(300):
        blind.engine.step(AHEAD, TICK_S)
        kept.append(ground.read())
        feels.engine.step(AHEAD, TICK_S, kept.pop(0))
    assert feels.engine.odometry.x_m > 0.75 * blind.engine.odometry.x_m
    assert all(abs(foot[2]) < 0.04 for foot in feels.engine.feet.values())


def test_a_foot_that_went_too_deep_before_its_contact_was_reported_goes_up_again() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, x_m: -0.015 if leg == 4 and x_m > 0.1 else 0.0)
    kept, deep_m = [ground.read()] * 5, []
    for _ in range(600):
        kept.append(ground.read())
        walked.engine.step(AHEAD, TICK_S, kept.pop(0))
        if 4 in walked.engine.standing:
            deep_m.append(walked.engine.feet[4][2])
    assert median(deep_m[-200:]) > -0.017
    assert walked.engine._state.lateness.certain_s >= 0.08


def test_lateness_is_the_median_of_contacts_and_a_punctual_sensor_has_none() -> None:
    def learned(lates_s: list[float]) -> float:
        lateness = Lateness()
        for late_s in lates_s * 40:
            lateness = lateness.after(late_s)
        return lateness.certain_s

    assert learned([-0.04, 0.2, -0.1]) == 0.0
    assert learned([0.1]) == pytest.approx(0.1, abs=0.006)
    assert learned([0.1, 0.4, 0.02, 0.1]) == pytest.approx(0.1, abs=0.02)
    assert learned([9.0]) == LATE_S


@pytest.mark.parametrize(
    ("reads", "sentence"),
    [(telemetry([1.0] * 6, roll_rad=1.2), "has fallen"), (telemetry([0.0] * 6), "somebody has lifted it")],
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
    at = walked.engine.odometry
    ground.run(1.0, AHEAD)
    assert walked.engine.odometry == at
    ground.run(0.1)
    ground.run(2.0, AHEAD)
    assert walked.engine.odometry.x_m > at.x_m + 0.05


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


def test_it_sits_down_and_stands_up_although_its_belly_unloads_its_feet() -> None:
    walked = standing(ROBOT)
    engine = walked.engine
    Ground(walked, flat).run(1.0)
    for go, posture in ((engine.sit, Posture.SITTING), (engine.stand, Posture.STANDING)):
        go()
        while engine.posture is not posture:
            engine.step(STILL, TICK_S, telemetry([0.0] * 6))
            assert not engine.felt.fault


def test_a_foot_on_a_stone_is_lifted_no_higher_than_its_disc_allows() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, _: 0.02 if leg in (1, 6) else 0.0)
    for _ in range(300):
        ground.run(TICK_S, AHEAD)
        assert max(foot[2] for foot in walked.engine.feet.values()) < LIFT_M + 0.002
    assert walked.engine.odometry.x_m > 0.2


def test_a_contact_that_is_reported_late_at_the_lowest_point_is_no_edge() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, _: -0.0299 if leg == 1 else 0.0)
    kept = [ground.read()] * 5
    for _ in range(400):
        kept.append(ground.read())
        walked.engine.step(AHEAD, TICK_S, kept.pop(0))
        assert not walked.engine.hanging
    assert walked.engine.odometry.x_m > 0.2


def test_below_a_body_that_leans_feet_rest_further_out_and_keep_their_strides() -> None:
    walked = standing(ROBOT)
    ground = Ground(walked, flat, pitch_rad=math.radians(12.0))
    ground.run(8.0, AHEAD)
    engine = walked.engine
    assert math.degrees(engine.corrected_rad) > 10.0
    assert engine.velocity.forward_m_s == pytest.approx(AHEAD.forward_m_s)
    further_m = [math.hypot(*engine.feet[leg][:2]) - math.hypot(*engine.stance.feet[leg][:2]) for leg in LEGS]
    assert sum(further_m) / len(LEGS) > 0.04


@pytest.mark.parametrize("ahead_m", [0.05, -0.05])
def test_a_walk_begins_with_the_feet_that_are_furthest_behind(ahead_m: float) -> None:
    """Feet at the edge of their discs would let it go nowhere before they are lifted."""
    walked = standing(ROBOT)
    engine = walked.engine
    for leg in (2, 3, 6):
        x, y, z = engine.feet[leg]
        engine._state.feet[leg] = x - math.copysign(engine._within_m + 0.003, ahead_m), y, z
    engine._state.place(ROBOT, LEGS)
    ground = Ground(walked, flat)
    ground.run(1.0, Velocity(ahead_m))
    assert abs(engine.odometry.x_m) > 0.02


def test_an_orientation_that_is_none_levels_nothing() -> None:
    imu = Imu(orientation_wxyz=(0.0, 0.0, 0.0, 0.0), angular_velocity_rad_s=_NONE, linear_acceleration_m_s2=_NONE)
    felt = Senses().take(telemetry().model_copy(update={"imu": imu}), TICK_S)
    assert (felt.roll_rad, felt.tilt_deg, felt.carrying) == (None, None, None)
    felt = Senses().take(telemetry(pitch_rad=math.radians(FALLEN_DEG + 10)), TICK_S)
    assert felt.pitch_rad is None
    assert felt.tilt_deg == pytest.approx(FALLEN_DEG + 10)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_measurements_that_are_no_numbers_change_nothing(number: float) -> None:
    imu = Imu(orientation_wxyz=(1.0, number, 0.0, 0.0), angular_velocity_rad_s=_NONE, linear_acceleration_m_s2=_NONE)
    blind, feels = standing(ROBOT), standing(ROBOT)
    nonsense = telemetry([1.0, number, 1.0, 1.0, 1.0, 1.0]).model_copy(update={"imu": imu})
    for _ in range(100):
        assert feels.engine.step(AHEAD, TICK_S, nonsense) == blind.engine.step(AHEAD, TICK_S)
        assert not feels.engine.felt.fault
    Ground(feels, flat).run(TICK_S)
    assert feels.engine.felt.carrying is not None
    assert any(feels.engine.felt.carrying)


def test_a_robot_on_its_back_or_with_an_imu_upside_down_does_not_walk() -> None:
    feels = standing(ROBOT)
    for _ in range(20):
        pose = feels.engine.step(STILL, TICK_S, telemetry([1.0] * 6, roll_rad=math.pi))
    for _ in range(100):
        assert feels.engine.step(AHEAD, TICK_S, telemetry([1.0] * 6, roll_rad=math.pi)) == pose
    assert feels.engine.limit == "the body leans by 180 degrees: it has fallen"


def test_telemetry_that_ends_in_a_stride_is_blind_walking_from_there_on() -> None:
    """Also where a foot waits on its way down: none stays in the air, and none goes deeper."""
    walked = standing(ROBOT)
    ground = Ground(walked, lambda leg, x_m: -0.025 if leg in (1, 4) and x_m > 0.02 else 0.0)
    while not any(swing.late_s for swing in walked.engine._state.swings.values()):
        ground.run(TICK_S, AHEAD)
    at_m = walked.engine.odometry.x_m
    for _ in range(150):
        walked.engine.step(AHEAD, TICK_S)
    assert walked.engine.odometry.x_m > at_m + 0.15
    assert not walked.engine.hanging
    assert all(abs(walked.engine.feet[leg][2]) < 0.001 for leg in walked.engine.standing)


def test_a_walker_adapts_only_where_it_is_asked_to() -> None:
    leaning = telemetry([1.0] * 6, roll_rad=0.1)
    for terrain, tilt_deg in (("level", None), ("adapt", pytest.approx(math.degrees(0.1)))):
        walker = Walker(ROBOT, terrain=terrain)
        walker.stand(None, 0.0)
        for number in range(300):
            walker.tick(number * TICK_S, leaning)
        state = walker.state
        assert (state.terrain, state.tilt_deg) == (terrain, tilt_deg)
        assert state.carrying == (None if terrain == "level" else (True,) * 6)
        assert (walker.engine.body.roll_rad != 0.0) == (terrain == "adapt")
    with pytest.raises(WalkError, match="there is no terrain 'moon'; there are level, adapt"):
        Walker(ROBOT, terrain="moon")


def test_telemetry_counts_while_it_is_fresh() -> None:
    measured, late = ReceivedTelemetry(), telemetry().model_copy(update={"age_ms": 200.0})
    assert measured.fresh(0.0) is None
    measured.take(telemetry(), 1.0)
    assert measured.fresh(1.2) is not None
    assert measured.fresh(1.4) is None
    measured.take(late, 2.0)
    assert measured.fresh(2.05) is late
    assert measured.fresh(2.15) is None
