"""The gait engine: what holds at every tick, over all gaits, directions, phases and changes; walks and postures."""

import math
import tomllib
from functools import cache
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.errors import WalkError
from gateway.geometry import load
from gateway.people.walking import gait_speed
from gateway.people.walking.engine import Engine
from gateway.people.walking.gaits import GAITS, NUMBERS, gait, phase
from gateway.people.walking.motion import STILL, BodyPose, Posture, Velocity
from gateway.people.walking.robot import Range, Robot, check_mirrored_once
from gateway.robot.settings import load as load_settings
from schemas.calibration import Calibration
from schemas.robot import LEGS
from tests.support.walked import TICK_S, Walked, legs_that_carry, standing

pytestmark = pytest.mark.full

ELKAPOD: Final = Path(__file__).parents[3] / "examples" / "elkapod"


@cache
def robot(name: str) -> Robot:
    """Return the default robot, or the example's with its limits; `slow` has servos of a third of the speed."""
    if name == "elkapod":
        limits = load_settings(ELKAPOD / "gateway.toml", simulated=True).limits.servos
        ranges = {int(key): Range(each.min_deg, each.max_deg, each.max_speed_deg_s) for key, each in limits.items()}
        return Robot(load(ELKAPOD / "geometry.json"), ranges)
    speeds = {10 * leg + joint: Range(max_speed_deg_s=90.0) for leg in LEGS for joint in (1, 2, 3)}
    return Robot(load(), speeds if name == "slow" else {})


names = st.sampled_from(("default", "elkapod", "slow"))
gaits = st.sampled_from(sorted(GAITS))
velocities = st.one_of(
    st.builds(Velocity, *[st.floats(-0.3, 0.3)] * 2, st.floats(-1.0, 1.0)),
    st.builds(
        lambda angle, speed: Velocity(speed * math.cos(angle), speed * math.sin(angle)), st.floats(0, 6.3), st.just(0.1)
    ),
    st.just(STILL),
)
walks = st.lists(st.tuples(velocities, st.integers(1, 100)), min_size=1, max_size=4)


@given(name=names, of=gaits, walk=walks)
@settings(max_examples=15)
def test_whatever_it_is_asked_for_it_keeps_its_limits_and_does_not_fall(
    name: str, of: str, walk: list[tuple[Velocity, int]]
) -> None:
    """Angles, speeds, three feet, the centre of mass, rigid stances, slewed velocities: `Walked` checks each tick."""
    walked = standing(robot(name), of)
    for velocity, ticks in walk:
        for _ in range(ticks):
            walked.tick(velocity)
    walked.until(Posture.STANDING, 4 * GAITS[of].period_s)


@pytest.mark.parametrize("of", sorted(GAITS))
def test_a_walk_ends_in_any_phase_within_a_stride_on_six_feet(of: str) -> None:
    walked = standing(robot("default"), of)
    walked.run(2.0, Velocity(0.3, 0.05))
    for _ in range(7):
        ended = walked.copy()
        ended.until(Posture.STANDING, GAITS[of].period_s)
        assert len(legs_that_carry(ended.engine)) == 6
        assert all(foot[2] == 0 for foot in ended.engine.state.feet.values())
        walked.run(0.46, Velocity(0.3, 0.05))


@pytest.mark.parametrize("name", ["default", "elkapod"])
@pytest.mark.parametrize("of", sorted(GAITS))
def test_a_walk_that_brakes_in_any_phase_stands_at_once_and_goes_on_from_there(name: str, of: str) -> None:
    walked, ahead = standing(robot(name), of), Velocity(0.3, 0.05, 0.2)
    walked.run(2.0, ahead)
    for _ in range(9):
        ended = walked.copy()
        ended.engine.brake()
        ended.run(TICK_S, ahead)
        took_s = TICK_S + ended.until(Posture.STANDING, 1.0)
        assert took_s <= gait_speed.HALT_S + 1.5 * TICK_S
        assert all(foot[2] == 0 for foot in ended.engine.state.feet.values())
        stood = ended.engine.pose
        ended.tick()
        assert ended.engine.pose == stood
        ended.run(1.0, ahead)
        assert ended.engine.posture is Posture.WALKING
        walked.run(0.14, ahead)


@pytest.mark.parametrize("of", sorted(GAITS))
@pytest.mark.parametrize(
    "velocity", [Velocity(0.02), Velocity(-0.02), Velocity(0, 0.02), Velocity(0, 0, 0.05), Velocity(0.015, 0, 0.03)]
)
def test_it_goes_where_it_was_sent(of: str, velocity: Velocity) -> None:
    walked = standing(robot("default"), of)
    walked.run(5.0, velocity)
    walked.until(Posture.STANDING, 4.0)
    went, turned = walked.engine.state.odometry[:2], walked.engine.state.odometry.heading_rad
    assert turned == pytest.approx(5 * velocity.turn_rad_s, abs=0.025)
    assert math.hypot(*went) == pytest.approx(5 * math.hypot(*velocity[:2]), abs=0.01)
    assert walked.engine.scaled == STILL
    assert walked.engine.limit == ""


@pytest.mark.parametrize("of", sorted(GAITS))
def test_a_foot_lands_as_far_ahead_of_its_rest_as_it_leaves_behind_it(of: str) -> None:
    walked, velocity, stood = standing(robot("default"), of), Velocity(0.05), {leg: list[float]() for leg in LEGS}
    walked.run(3 * GAITS[of].period_s, velocity)
    for _ in range(round(4 * GAITS[of].period_s / TICK_S)):
        walked.tick(velocity)
        state = walked.engine.state
        for leg in legs_that_carry(walked.engine):
            stood[leg].append(state.feet[leg][0] - state.rests[leg][0])
    ways_m = 2 * TICK_S * velocity.forward_m_s
    for ahead_m in stood.values():
        assert max(ahead_m) == pytest.approx(-min(ahead_m), abs=ways_m)
        assert sum(ahead_m) / len(ahead_m) == pytest.approx(0, abs=ways_m)


def test_limits_that_leave_no_stride_leave_a_robot_that_stands() -> None:
    stiff = {10 * leg + 1: Range(89.0, 91.0) for leg in LEGS}
    walked = standing(Robot(load(), stiff))
    with pytest.raises(WalkError, match=r"its limits leave it no stride 0\.15\d* m high: servo 11 would stand at"):
        walked.engine.stance.check_walks()


def test_a_geometry_that_mirrors_what_the_calibration_mirrors_is_rejected() -> None:
    """The default file counts as the wire does, the Elkapod's as commands do; its calibration lies between them."""
    with (ELKAPOD / "calibration.toml").open("rb") as file:
        calibration = Calibration(revision=1, landing={}, servos=tomllib.load(file)["servos"])
    check_mirrored_once(load(), None)
    check_mirrored_once(load(), calibration.model_copy(update={"servos": {}}))
    check_mirrored_once(load(ELKAPOD / "geometry.json"), calibration)
    with pytest.raises(WalkError, match=r"servos 22, 42, 62 are turned round by the calibration, and by the geometry"):
        check_mirrored_once(load(), calibration)


def test_a_height_that_the_legs_cannot_reach_is_an_error_that_says_why() -> None:
    for height_m in (0.02, 0.4, -1.0):
        with pytest.raises(WalkError, match="it cannot stand"):
            robot("default").stance(BodyPose(height_m))
    with pytest.raises(WalkError, match="are finite numbers"):
        robot("default").stance(BodyPose(math.nan))


@pytest.mark.parametrize(
    "numbers", [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, -11), (1e9, 0, 0), (True, 0, 0), ("1", 0, 0), (None, 0, 0)]
)
def test_what_is_no_velocity_is_rejected(numbers: tuple[float, float, float]) -> None:
    with pytest.raises(WalkError, match=r"a velocity is a finite number|no walking robot does"):
        Velocity.checked(*numbers)


def test_the_bridge_numbers_every_gait_of_the_table_and_the_elkapods_as_it_does() -> None:
    assert [NUMBERS[number] for number in range(3)] == ["wave", "ripple", "tripod"]
    assert sorted(NUMBERS.values()) == sorted(GAITS)


@pytest.mark.parametrize(("of", "most"), [("tripod", 3), ("ripple", 2), ("wave", 1)])
def test_the_table_lifts_no_more_than_the_gaits_name_says(of: str, most: int) -> None:
    swings = [sum(phase(gait(of), leg, clock / 1000) < 1 - gait(of).duty for leg in LEGS) for clock in range(1000)]
    assert max(swings) == most
    assert min(swings) <= most - 1 or of == "ripple"


# ---- standing up from any pose (a leg that somebody else stops: test_ride.py)

ROBOT: Final = Robot(load())
WAY_S: Final = 12.0
"""The longest way: folded legs, up, steps and the pose, each with slow servos."""
angles = st.tuples(*[st.floats(0, 1)] * 3)


@given(parts=st.fixed_dictionaries(dict.fromkeys(LEGS, angles)), missing=st.sets(st.sampled_from(LEGS)))
@settings(max_examples=12)
def test_from_any_pose_of_the_legs_that_run_it_stands_up_three_legs_at_a_time(
    parts: dict[int, tuple[float, float, float]], missing: set[int]
) -> None:
    """Whatever the servos were last commanded to, and whichever legs are slack."""
    pose = {}
    for leg in set(LEGS) - missing:
        limits = [ROBOT.ranges[10 * leg + joint] for joint in (1, 2, 3)]
        first, second, third = (
            each.min_deg + part * (each.max_deg - each.min_deg) for each, part in zip(limits, parts[leg], strict=True)
        )
        pose[leg] = first, second, third
    engine = Engine(ROBOT, angles_deg=pose)
    for leg, angles_deg in pose.items():
        assert engine.pose[leg] == pytest.approx(angles_deg)
    walked = Walked(engine)
    walked.checks_balance = False
    engine.stand()
    for _ in range(round(WAY_S / 0.02)):
        before, body = engine.pose, engine.state.body
        walked.tick()
        if engine.posture is Posture.STANDING:
            break
        moved = [leg for leg in LEGS if engine.pose[leg] != before[leg]]
        lies = engine.state.body.height_m <= ROBOT.lying_m
        assert len(moved) <= 3 or lies or engine.state.body != body, "the others carry it"
    assert engine.posture is Posture.STANDING
    assert engine.state.body.height_m == pytest.approx(ROBOT.usual_m)
    walked.checks_balance = True
    walked.run(1.0, Velocity(0.1))
