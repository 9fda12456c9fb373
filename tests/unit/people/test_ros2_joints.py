"""What controllers ask for, read: joint names in any order, and trajectories in time."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st

from gateway.geometry import joint_name, load
from gateway.people.ros2.joints import JointNames, JointsError, check_reach, legs_deg, positions
from gateway.people.ros2.messages import Duration, Header, JointTrajectory, JointTrajectoryPoint, Time
from gateway.people.ros2.trajectory import MAX_POINTS, MAX_RAD_S, Trajectory
from schemas.robot import SERVO_IDS

GEOMETRY = load()
NAMES = JointNames()
NOW_NS = 1_000_000 * 10**9
NOW_S = 50.0
LEG = ("joint_11", "joint_12", "joint_13")
REST = (0.0, 0.5, -1.5)
FAST = (5.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
HALF_TURN_RAD = math.pi / 2
NEARLY = 1e-3
"""What extremes between the places looked at may add, and rounding."""


def point(at_s: float, first_rad: float, **more: tuple[float, ...]) -> JointTrajectoryPoint:
    nanoseconds = round(at_s * 1e9)
    duration = Duration(*divmod(nanoseconds, 10**9))
    return JointTrajectoryPoint((first_rad, *REST[1:]), time_from_start=duration, **more)


def trajectory(*points: JointTrajectoryPoint, begins_s: float | None = None) -> JointTrajectory:
    """`begins_s`: relative to now, as a stamp."""
    stamp = Time() if begins_s is None else Time(*divmod(NOW_NS + round(begins_s * 1e9), 10**9))
    return JointTrajectory(Header(stamp), LEG, points)


def read(message: JointTrajectory) -> Trajectory:
    return Trajectory.read(message, NAMES, GEOMETRY, NOW_S, NOW_NS)


# ---- joints


@given(st.permutations(SERVO_IDS), st.integers(0, 5))
def test_joints_in_any_order_are_the_same_legs(order: list[int], away: int) -> None:
    order = [servo_id for servo_id in order if servo_id // 10 > away]
    at_rad = {servo_id: GEOMETRY.joint_rad(servo_id, 90 + servo_id / 10) for servo_id in order}
    read_rad = positions(NAMES.servos([joint_name(servo_id) for servo_id in order]), [at_rad[each] for each in order])
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
        NAMES.servos(names)


def test_another_stacks_joint_names_are_taken_alone() -> None:
    names = JointNames("leg{leg}_J{joint}")
    assert names.servos(["leg6_J3", "leg6_J1", "leg6_J2"]) == (63, 61, 62)
    assert [names.of(servo_id) for servo_id in (11, 63)] == ["leg1_J1", "leg6_J3"]
    with pytest.raises(JointsError, match="no joint 'joint_61'; they are leg1_J1 to leg6_J3"):
        names.servos(["joint_61", "joint_62", "joint_63"])


@pytest.mark.parametrize(
    "pattern", ["", "joint", "leg{leg}", "{joint}", "{leg}{joint}{}", "{leg.__class__}{joint}", "a<b"]
)
def test_patterns_that_do_not_name_each_joint(pattern: str) -> None:
    with pytest.raises(JointsError, match=r"no pattern of joint names|gives two joints one name"):
        JointNames(pattern)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ((0.0, 0.0), "one position for each of 3 joints, not 2"),
        ((0.0, math.nan, 0.0), "joint_12 is nan"),
        ((0.0, 0.0, -math.inf), "joint_13 is -inf"),
    ],
)
def test_positions_that_are_not_taken(values: tuple[float, ...], why: str) -> None:
    with pytest.raises(JointsError, match=why):
        positions((11, 12, 13), values)


def test_a_servo_turns_half_a_turn() -> None:
    check_reach(GEOMETRY, {11: math.pi / 2})
    with pytest.raises(JointsError, match=r"joint_11 at 1\.6 rad is 181\.7° of its servo"):
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


@given(st.lists(st.tuples(st.floats(0.01, 2), st.floats(-1.5, 1.5), st.floats(-5.2, 5.2)), min_size=2, max_size=4))
def test_a_trajectory_is_taken_exactly_where_it_stays_within_range_and_speed(
    way: list[tuple[float, float, float]],
) -> None:
    """What bends too far or too fast between its points is rejected, and is never clamped."""
    times_s = list(itertools.accumulate(round(each[0], 3) for each in way))
    points = [point(at_s, at, velocities=(speed, 0.0, 0.0)) for at_s, (_, at, speed) in zip(times_s, way, strict=True)]
    furthest_rad, fastest_rad_s = extremes(points)
    event(f"range kept: {furthest_rad <= HALF_TURN_RAD}, speed kept: {fastest_rad_s <= MAX_RAD_S}")
    try:
        plan = read(trajectory(*points))
    except JointsError:
        assert furthest_rad > HALF_TURN_RAD - NEARLY or fastest_rad_s > MAX_RAD_S - NEARLY
        return
    assert furthest_rad < HALF_TURN_RAD + NEARLY
    assert fastest_rad_s < MAX_RAD_S * 1.001 + NEARLY
    plan.begin({}, NOW_S)
    for at_s, (_, at, _) in zip(times_s, way, strict=True):
        assert plan.at(NOW_S + at_s)[11] == pytest.approx(at, abs=1e-6)


def extremes(points: list[JointTrajectoryPoint]) -> tuple[float, float]:
    """The furthest radians and the fastest radians a second of a spline by its Bernstein form, at many places."""
    furthest, fastest = 0.0, 0.0
    part = np.linspace(0, 1, 501)
    rest = 1 - part
    for before, after in itertools.pairwise(points):
        length_s = seconds(after) - seconds(before)
        begin, end = before.positions[0], after.positions[0]
        leaves, arrives = begin + before.velocities[0] * length_s / 3, end - after.velocities[0] * length_s / 3
        way = begin * rest**3 + 3 * leaves * part * rest**2 + 3 * arrives * part**2 * rest + end * part**3
        speed = (leaves - begin) * rest**2 + 2 * (arrives - leaves) * part * rest + (end - arrives) * part**2
        furthest = max(furthest, float(abs(way).max()))
        fastest = max(fastest, 3 * float(abs(speed).max()) / length_s)
    return furthest, fastest


def seconds(point: JointTrajectoryPoint) -> float:
    return point.time_from_start.sec + point.time_from_start.nanosec / 1e9


def test_from_where_the_robot_is_it_goes_no_faster_either() -> None:
    plan = read(trajectory(point(0.1, 0.4), point(3, 0.0)))
    plan.begin({11: 0.0}, NOW_S)
    with pytest.raises(JointsError, match=r"joint_11 would turn at 802\.1°/s from where it is; at most 300°/s"):
        plan.begin({11: -1.0}, NOW_S)
    assert plan.at(NOW_S)[11] == pytest.approx(0.0), "what it has begun with stays"
    read(trajectory(point(0, 0.4), point(3, 0.0))).begin({11: 0.401}, NOW_S)  # its first point is where it is, nearly


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
        (trajectory(point(1, 1e308)), r"point 1: joint_11 at 1e\+308 rad is -?inf° of its servo"),
        (trajectory(point(1, 0, velocities=(1e308, 0, 0))), r"velocity of joint_11 is 1e\+308 rad/s, more than 5\.236"),
        (
            trajectory(point(1, 0, velocities=(20.0, -90, 0))),
            r"velocity of joint_11 is 20 rad/s, .* \(are these degrees",
        ),
        (trajectory(point(1, 0, velocities=(0, 0, math.nan))), "point 1: the velocity of joint_13 is nan"),
        (
            trajectory(point(1, 0, accelerations=(1e308, 0, 0))),
            r"acceleration of joint_11 is 1e\+308 rad/s², more than 261",
        ),
        (trajectory(point(1, 0, accelerations=(0.0,))), "one acceleration for each of 3 joints, not 1"),
        (
            trajectory(point(1, 0), point(1.1, 1)),
            r"point 2: joint_11 would turn at -?573°/s on the way there; at most 300°/s",
        ),
        (
            trajectory(point(1, 0, velocities=FAST), point(4, 0, velocities=STILL)),
            r"point 2: joint_11 at 2\.222 rad is 217\.3°",
        ),
        (trajectory(point(1, 0), point(2, 9)), r"point 2: joint_11 at 9 rad is"),
        (trajectory(point(1, 0, velocities=(0.0,))), "point 1: there must be one velocity for each of 3 joints, not 1"),
        (
            trajectory(replace(point(1, 0), positions=())),
            "point 1: there must be one position for each of 3 joints, not 0",
        ),
        (trajectory(point(1, 0), begins_s=-1.5), r"over 0\.5 s ago by its stamp"),
        (trajectory(point(1, 0), begins_s=61), r"begins in 61\.0 s by its stamp"),
    ],
)
def test_trajectories_that_are_not_taken(message: JointTrajectory, why: str) -> None:
    with pytest.raises(JointsError, match=why):
        read(message)
