"""Standing up, sitting down and what lies between, from any pose; and a leg that somebody else stops."""

import math
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.geometry import load
from gateway.people.walking import STILL, Engine, Posture, Robot, Velocity, Walker
from gateway.people.walking.motion import BodyPose
from gateway.people.walking.ways import ON_GROUND_M
from schemas.robot import LEGS
from tests.support.walked import Walked, standing

pytestmark = pytest.mark.full

ROBOT: Final = Robot(load())
WAY_S: Final = 12.0
"""The longest way: folded legs, up, steps and the pose, each with slow servos."""
heights = st.floats(0.08, 0.2)
leans = st.floats(-0.12, 0.12)
angles = st.tuples(*[st.floats(0, 1)] * 3)


def stance_or_none(height_m: float, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> BodyPose | None:
    try:
        return ROBOT.stance(BodyPose(height_m, roll_rad, pitch_rad)).body
    except ValueError:
        return None


@given(poses=st.lists(st.one_of(st.none(), st.tuples(heights, leans, leans)), min_size=1, max_size=3))
@settings(max_examples=8)
def test_from_each_posture_to_each_other_without_a_jump_or_a_fall(
    poses: list[tuple[float, float, float] | None],
) -> None:
    walked = standing(ROBOT)
    for pose in poses:
        body = None if pose is None else stance_or_none(*pose)
        if pose is not None and body is None:
            continue
        if body is None:
            walked.engine.sit()
            walked.until(Posture.SITTING, WAY_S)
            assert walked.engine.body.height_m == pytest.approx(ROBOT.lying_m)
        else:
            walked.engine.stand(ROBOT.stance(body))
            walked.until(Posture.STANDING, WAY_S)
            assert walked.engine.body == pytest.approx(body)
        assert all(foot[2] == pytest.approx(0, abs=1e-9) for foot in walked.engine.feet.values())


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
        before = engine.pose
        walked.tick()
        if engine.posture is Posture.STANDING:
            break
        moved = [leg for leg in LEGS if engine.pose[leg] != before[leg]]
        on_belly = engine.body.height_m <= ROBOT.lying_m
        level = engine.body == walked.engine.body
        assert len(moved) <= 3 or not on_belly or level
    assert engine.posture is Posture.STANDING
    assert engine.body.height_m == pytest.approx(ROBOT.usual_m)
    walked.checks_balance = True
    walked.run(1.0, Velocity(0.1))


def test_a_walk_that_others_left_standing_goes_on_from_where_it_stands() -> None:
    """No sitting down and up again: the pose stands, so it is taken as it is."""
    walked = standing(ROBOT)
    walked.run(2.3, Velocity(0.1))
    walked.until(Posture.STANDING, 2.0)
    taken = Walked(Engine(ROBOT, angles_deg=walked.engine.pose))
    assert taken.engine.posture is Posture.STANDING
    assert taken.engine.body.height_m == pytest.approx(ROBOT.usual_m, abs=1e-6)
    taken.run(2.0, Velocity(0.1))
    assert taken.engine.odometry.x_m > 0.1


def test_a_lost_leg_in_any_phase_leaves_the_others_standing_still() -> None:
    walked = standing(ROBOT)
    walked.checks_balance = False  # which feet then carry is not ours to choose
    walked.run(2.0, Velocity(0.1))
    for _ in range(6):
        for lost in ((3,), (1, 4)):
            lose(walked.copy(), lost)
        walked.run(0.38, Velocity(0.1))


def lose(walked: Walked, lost: tuple[int, ...]) -> None:
    """These legs in this phase; the others stand still, and the walk goes on once they run again."""
    frozen = {leg: walked.engine.pose[leg] for leg in lost}
    walked.engine.halt(lost)
    walked.run(1.5, Velocity(0.1))
    assert walked.engine.posture is Posture.HALTED
    assert walked.engine.pose.keys() == set(LEGS) - set(lost)
    assert all(walked.engine.feet[leg][2] == pytest.approx(0, abs=1e-9) for leg in walked.engine.pose)
    still = walked.engine.pose
    walked.run(1.0, Velocity(0.1))
    assert walked.engine.pose == still

    walked.engine.resume()
    assert {leg: walked.engine.pose[leg] for leg in lost} == frozen
    walked.pose = walked.engine.pose
    walked.until(Posture.STANDING, 1.0)
    walked.checks_balance = True
    x_m = walked.engine.odometry.x_m
    walked.run(1.5, Velocity(0.1))
    assert walked.engine.odometry.x_m > x_m + 0.1


@pytest.mark.parametrize("after_s", [0.0, 0.46, 0.92, 1.38, 1.84, 2.3])
def test_a_leg_that_is_lost_on_the_way_to_a_posture_ends_the_way(after_s: float) -> None:
    walked = Walked(Engine(ROBOT))
    walked.checks_balance = False
    walked.engine.stand()
    walked.run(after_s)
    frozen = walked.engine.pose[2]
    walked.engine.halt([2])
    walked.run(1.0)
    still = walked.engine.pose
    walked.run(1.0)
    assert walked.engine.pose == still
    walked.engine.resume()
    assert walked.engine.pose[2] == frozen, "it starts where it was stopped"
    walked.pose = walked.engine.pose
    walked.engine.stand()
    walked.until(Posture.STANDING, WAY_S)


def test_a_leg_that_runs_again_at_once_leaves_no_other_in_the_air() -> None:
    """The others are still on their way down."""
    walked = Walked(Engine(ROBOT))
    walked.checks_balance = False
    walked.engine.stand()
    walked.run(2.3)
    assert len([leg for leg in LEGS if walked.engine.feet[leg][2] > ON_GROUND_M]) == 3, "a step of three legs"
    walked.engine.halt([2])
    walked.run(0.06)
    walked.engine.resume()
    walked.pose = walked.engine.pose
    walked.until(Posture.STANDING, 1.0)
    assert [foot[2] for foot in walked.engine.feet.values()] == pytest.approx([0] * 6, abs=1e-9)


def test_the_feet_of_a_way_do_not_scrape() -> None:
    """A foot that is on the ground stands where it is, in the ground frame, until it is lifted."""
    walked = standing(ROBOT)
    walked.engine.sit()
    while walked.engine.posture is not Posture.SITTING:
        before = dict(walked.engine.feet)
        walked.tick()
        for leg in LEGS:
            if before[leg][2] == walked.engine.feet[leg][2] == 0:
                assert math.dist(before[leg], walked.engine.feet[leg]) < 1e-9


def test_up_and_down_take_less_than_three_seconds_each() -> None:
    walked = Walked(Engine(ROBOT))
    walked.engine.stand()
    assert walked.until(Posture.STANDING, WAY_S) < 3.0
    walked.engine.sit()
    assert walked.until(Posture.SITTING, WAY_S) < 3.0
    assert walked.engine.velocity == STILL


def test_a_silent_driver_has_the_robot_stand_then_sit_then_be_over() -> None:
    """By the clock alone; a way that it was sent on is no silence, however long it takes."""
    walker = Walker(ROBOT, hold_s=0.5, rest_s=2.0)
    walker.stand(None, 0.0)
    now_s = 0.0
    while walker.state.posture is not Posture.STANDING:
        now_s += 0.02
        walker.tick(now_s)
    assert now_s > walker.rest_s
    begun_s = now_s
    walker.go(Velocity(0.1), now_s)
    postures: list[Posture] = []
    while not walker.is_over:
        now_s += 0.02
        walker.tick(now_s)
        if now_s - begun_s < 0.49:
            assert walker.state.commanded == Velocity(0.1)
        if now_s - begun_s > 0.51:
            assert walker.state.commanded == STILL
        if not postures or postures[-1] is not walker.state.posture:
            postures.append(walker.state.posture)
    assert postures == [Posture.WALKING, Posture.STANDING, Posture.MOVING, Posture.SITTING]
    assert now_s - begun_s < 7
    x_m = walker.state.odometry.x_m
    assert 0 < x_m < 0.1
    walker.go(Velocity(0.1), now_s)
    assert not walker.is_over
    walker.tick(now_s + 0.02)
    assert walker.state.posture is Posture.MOVING
