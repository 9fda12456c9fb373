"""What controllers ask for, read: joint names in any order, and trajectories in time."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.geometry import joint_name, load
from gateway.people.ros2.joints import JointsError, check_reach, legs_deg, positions, servos_of
from gateway.people.ros2.messages import Duration, Header, JointTrajectory, JointTrajectoryPoint, Time
from gateway.people.ros2.trajectory import MAX_POINTS, Trajectory
from schemas.robot import SERVO_IDS

GEOMETRY = load()
NOW_NS = 1_000_000 * 10**9
NOW_S = 50.0
LEG = ("joint_11", "joint_12", "joint_13")
REST = (0.0, 0.5, -1.5)


def point(at_s: float, first_rad: float, **more: tuple[float, ...]) -> JointTrajectoryPoint:
    nanoseconds = round(at_s * 1e9)
    duration = Duration(*divmod(nanoseconds, 10**9))
    return JointTrajectoryPoint((first_rad, *REST[1:]), time_from_start=duration, **more)


def trajectory(*points: JointTrajectoryPoint, begins_s: float | None = None) -> JointTrajectory:
    """`begins_s`: relative to now, as a stamp."""
    stamp = Time() if begins_s is None else Time(*divmod(NOW_NS + round(begins_s * 1e9), 10**9))
    return JointTrajectory(Header(stamp), LEG, points)


def read(message: JointTrajectory) -> Trajectory:
    return Trajectory.read(message, GEOMETRY, NOW_S, NOW_NS)


# ---- joints


@given(st.permutations(SERVO_IDS), st.integers(0, 5))
def test_joints_in_any_order_are_the_same_legs(order: list[int], away: int) -> None:
    order = [servo_id for servo_id in order if servo_id // 10 > away]
    at_rad = {servo_id: GEOMETRY.joint_rad(servo_id, 90 + servo_id / 10) for servo_id in order}
    read_rad = positions(servos_of([joint_name(servo_id) for servo_id in order]), [at_rad[each] for each in order])
    assert read_rad == at_rad
    for leg, angles in legs_deg(GEOMETRY, read_rad).items():
        assert angles == pytest.approx(tuple(90 + (10 * leg + joint) / 10 for joint in (1, 2, 3)))


@pytest.mark.parametrize(
    ("names", "why"),
    [
        ((), "names no joint"),
        (("joint_11", "joint_12", "joint_13", "gripper"), "no joint 'gripper'"),
        (("joint_11", "joint_12", "joint_14"), "no joint 'joint_14'"),
        (("joint_11", "joint_12", "joint_13", "joint_12"), "joint_12 twice"),
        (("joint_11", "joint_13"), "of leg 1 it lacks joint_12"),
        (("joint_71",), "no joint 'joint_71'"),
    ],
)
def test_names_that_are_not_taken(names: tuple[str, ...], why: str) -> None:
    with pytest.raises(JointsError, match=why):
        servos_of(names)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ((0.0, 0.0), "2 positions for 3 joints"),
        ((0.0, math.nan, 0.0), "joint_12 is nan"),
        ((0.0, 0.0, -math.inf), "joint_13 is -inf"),
    ],
)
def test_positions_that_are_not_taken(values: tuple[float, ...], why: str) -> None:
    with pytest.raises(JointsError, match=why):
        positions((11, 12, 13), values)


def test_a_servo_turns_half_a_turn() -> None:
    check_reach(GEOMETRY, {11: math.pi / 2})
    with pytest.raises(JointsError, match=r"joint_11 at 1\.600 rad is 181\.7° of its servo"):
        check_reach(GEOMETRY, {11: 1.6})


# ---- trajectories


def test_it_is_followed_from_where_the_robot_is_in_straight_lines() -> None:
    plan = read(trajectory(point(1, 0.4), point(3, 0.0)))
    plan.begin({11: 0.2, 12: 0.5, 13: -1.5}, NOW_S)
    seen = [plan.at(NOW_S + at_s)[11] for at_s in (0, 0.5, 1, 2, 3, 99)]
    assert seen == pytest.approx([0.2, 0.3, 0.4, 0.2, 0.0, 0.0])
    assert plan.at(NOW_S + 2)[13] == pytest.approx(-1.5)
    assert plan.ends_s == NOW_S + 3


def test_legs_that_do_not_run_begin_at_its_first_point() -> None:
    plan = read(trajectory(point(1, 0.4), point(2, 0.0)))
    plan.begin({}, NOW_S)
    assert plan.at(NOW_S)[11] == plan.at(NOW_S + 0.9)[11] == pytest.approx(0.4)


def test_velocities_make_curves_that_meet_their_points() -> None:
    moving = (0.4, 0.0, 0.0)
    plan = read(trajectory(point(1, 0.0, velocities=moving), point(2, 0.4, velocities=moving)))
    plan.begin({}, NOW_S)
    seen = [plan.at(NOW_S + 1 + part)[11] for part in (0.001, 0.25, 0.5, 0.75, 1)]
    assert seen == pytest.approx([0.0004, 0.1, 0.2, 0.3, 0.4], abs=1e-6), "at an even speed a cubic is a line"
    swing = read(trajectory(point(1, 0.0, velocities=moving), point(2, 0.0, velocities=(-0.4, 0.0, 0.0))))
    swing.begin({}, NOW_S)
    assert swing.at(NOW_S + 1.5)[11] == pytest.approx(0.1)


def test_one_that_has_begun_goes_on_from_where_the_robot_is() -> None:
    plan = read(trajectory(point(1, 0.4), point(3, 0.0), begins_s=-2.0))
    plan.begin({11: 0.3, 12: 0.5, 13: -1.5}, NOW_S)
    assert [plan.at(NOW_S + at_s)[11] for at_s in (0, 0.5, 1)] == pytest.approx([0.3, 0.15, 0.0])


def test_one_that_is_still_to_begin_is_approached_until_then() -> None:
    plan = read(trajectory(point(1, 0.4), begins_s=1.0))
    plan.begin({11: 0.0, 12: 0.5, 13: -1.5}, NOW_S)
    assert [plan.at(NOW_S + at_s)[11] for at_s in (0, 1, 2)] == pytest.approx([0.0, 0.2, 0.4])


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (trajectory(), "it has no points"),
        (trajectory(*[point(at_s / 100, 0) for at_s in range(1, MAX_POINTS + 2)]), "2001 points, more than 2000"),
        (trajectory(point(1, 0), point(1, 0.1)), "point 2: its time 1 s is not later"),
        (trajectory(point(2, 0), point(1, 0.1)), "point 2: its time 1 s is not later"),
        (trajectory(point(-1, 0)), "point 1: its time -1 s is not between 0 and 60 s"),
        (trajectory(point(61, 0)), "point 1: its time 61 s is not between"),
        (trajectory(point(1, math.nan)), "point 1: the position of joint_11 is nan"),
        (trajectory(point(1, 0), point(2, 9)), r"point 2: joint_11 at 9\.000 rad"),
        (trajectory(point(1, 0, velocities=(0.0,))), "point 1: it has 1 positions for 3"),
        (trajectory(replace(point(1, 0), positions=())), "point 1: it has 0 positions for 3"),
        (trajectory(point(1, 0), begins_s=-1.5), r"over 0\.5 s ago by its stamp"),
        (trajectory(point(1, 0), begins_s=61), r"begins in 61\.0 s by its stamp"),
    ],
)
def test_trajectories_that_are_not_taken(message: JointTrajectory, why: str) -> None:
    with pytest.raises(JointsError, match=why):
        read(message)
