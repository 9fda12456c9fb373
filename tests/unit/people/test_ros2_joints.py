"""What controllers ask for, read: joint names in any order, trajectories in time, and goals until they end."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from gateway.geometry import load
from gateway.people.ros2 import goals
from gateway.people.ros2.goals import Followed, GoalProgress, error_code
from gateway.people.ros2.messages import Header, Message, Time
from gateway.people.ros2.trajectory import MAX_POINTS, MAX_RAD_S, JointNames, JointsError, Trajectory
from tests.support.ros2_messages import (
    Duration,
    FollowGoal,
    JointTolerance,
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    replace,
)

GEOMETRY = load()
NAMES = JointNames()
NOW_NS = 1_000_000 * 10**9
NOW_S = 50.0
LEG = ("joint_11", "joint_12", "joint_13")
REST = (0.0, 0.5, -1.5)
HALF_TURN_RAD = math.pi / 2
NEARLY = 1e-3
"""What extremes between the places looked at may add, and rounding."""


def point(at_s: float, first_rad: float, **more: tuple[float, ...]) -> Message:
    nanoseconds = round(at_s * 1e9)
    duration = Duration(*divmod(nanoseconds, 10**9))
    return JointTrajectoryPoint((first_rad, *REST[1:]), time_from_start=duration, **more)


def trajectory(*points: Message, begins_s: float | None = None) -> Message:
    """`begins_s`: relative to now, as a stamp."""
    stamp = Time(0, 0) if begins_s is None else Time(*divmod(NOW_NS + round(begins_s * 1e9), 10**9))
    return JointTrajectory(Header(stamp), LEG, points)


def read(message: Message) -> Trajectory:
    return Trajectory.read(message, NAMES, GEOMETRY, NOW_S, NOW_NS)


# ---- joints


NO_PATTERNS = ("", "joint", "leg{leg}", "{joint}", "{leg}{joint}{}", "{leg.__class__}{joint}", "a<b")


@pytest.mark.parametrize(
    ("call", "names", "why"),
    [
        (NAMES.servos, (), "names no joint"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_13", "gripper"), "no joint 'gripper'"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_14"), "no joint 'joint_14'"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_13", "joint_12"), "joint_12 twice"),
        (NAMES.servos, ("joint_11", "joint_13"), "of leg 1 it lacks joint_12"),
        (NAMES.servos, ("joint_71",), "no joint 'joint_71'"),
        *((JointNames, each, "no pattern of joint names|gives two joints one name") for each in NO_PATTERNS),
    ],
)
def test_names_and_patterns_that_are_not_taken(call: Callable[[Any], object], names: object, why: str) -> None:
    with pytest.raises(JointsError, match=why):
        call(names)


# ---- trajectories


@pytest.mark.parametrize(
    ("begins_s", "first_rad", "at"),
    [
        (None, 0.2, {0: 0.2, 0.5: 0.3, 1: 0.4, 2: 0.2, 3: 0.0, 99: 0.0}),
        (-2.0, 0.3, {0: 0.3, 0.5: 0.15, 1: 0.0}),  # it has begun, and goes on from where the robot is
    ],
)
def test_it_is_followed_from_where_the_robot_is_in_straight_lines(
    begins_s: float | None, first_rad: float, at: dict[float, float]
) -> None:
    plan = read(trajectory(point(1, 0.4), point(3, 0.0), begins_s=begins_s))
    plan.begin({11: first_rad, 12: 0.5, 13: -1.5}, NOW_S)
    assert {at_s: plan.at(NOW_S + at_s)[11] for at_s in at} == pytest.approx(at)
    assert plan.at(NOW_S + 2)[13] == pytest.approx(-1.5)
    assert plan.ends_s == NOW_S + 3 + (begins_s or 0.0)


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


def extremes(points: list[Message]) -> tuple[float, float]:
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


def seconds(point: Message) -> float:
    return float(point.time_from_start.sec + point.time_from_start.nanosec / 1e9)


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
        (trajectory(point(-1, 0)), "point 1: its time -1 s is not between 0 and 60 s"),
        (trajectory(point(61, 0)), "point 1: its time 61 s is not between"),
        (trajectory(point(1, math.nan)), "point 1: the position of joint_11 is nan"),
        (trajectory(point(1, 1e308)), r"point 1: joint_11 at 1e\+308 rad is -?inf° of its servo"),
        (trajectory(point(1, 0, velocities=(1e308, 0, 0))), r"velocity of joint_11 is 1e\+308 rad/s, more than 5\.236"),
        (trajectory(point(1, 0, velocities=(20.0, -90, 0))), r"of joint_11 is 20 rad/s, .* \(are these degrees"),
        (trajectory(point(1, 0, velocities=(0, 0, math.nan))), "point 1: the velocity of joint_13 is nan"),
        (trajectory(point(1, 0, accelerations=(1e308, 0, 0))), r"of joint_11 is 1e\+308 rad/s², more than 261"),
        (trajectory(point(1, 0, accelerations=(0.0,))), "one acceleration for each of 3 joints, not 1"),
        (trajectory(point(1, 0), point(1.1, 1)), r"point 2: joint_11 would turn at -?573°/s .* at most 300°/s"),
        (trajectory(replace(point(1, 0), positions=())), "must be one position for each of 3 joints, not 0"),
        (trajectory(point(1, 0), begins_s=-1.5), r"over 0\.5 s ago by its stamp"),
        (trajectory(point(1, 0), begins_s=61), r"begins in 61\.0 s by its stamp"),
    ],
)
def test_trajectories_that_are_not_taken(message: Message, why: str) -> None:
    with pytest.raises(JointsError, match=why):
        read(message)


# ---- the goals of FollowJointTrajectory: how far one is, and how it ends


GOALS_LEG = ("joint_13", "joint_11", "joint_12")


def goal_of(*points: tuple[float, float], names: tuple[str, ...] = GOALS_LEG, begins_s: float | None = None) -> Message:
    """Seconds, and radians of joint_11."""
    turned = [
        replace(each, positions=(*each.positions[2:], *each.positions[:2])) for each in itertools.starmap(point, points)
    ]
    return FollowGoal(replace(trajectory(*turned, begins_s=begins_s), joint_names=names))


WAY = goal_of((1.0, 0.0), (2.0, 0.4))


def follow(goal: Message) -> Followed:
    followed = Followed(goal, NAMES, read(goal.trajectory))
    followed.plan.begin({}, NOW_S)
    return followed


def sent(followed: Followed, now_s: float, behind_rad: float = 0.0) -> GoalProgress:
    desired = followed.plan.at(now_s)
    return GoalProgress(desired, {**desired, 11: desired[11] - behind_rad})


def test_what_ends_the_motion_aborts_the_goal() -> None:
    judged = follow(WAY).judge(GoalProgress({}, {}, "the emergency stop was engaged"), NOW_S + 1)
    assert judged == goals.GoalResult(goals.INVALID_GOAL, "the emergency stop was engaged")


def on_path(within: float) -> dict[str, Any]:
    return {"path_tolerance": (JointTolerance("joint_11", within),)}


AT_END: Final[dict[str, Any]] = {
    "goal_tolerance": (JointTolerance("joint_11", 0.05 + 1e-9),),
    "goal_time_tolerance": Duration(0, 500_000_000),
}


@pytest.mark.parametrize(
    ("tolerance", "at_s", "behind_rad", "code"),
    [
        (on_path(0.05), 1.5, 0.06, goals.PATH_TOLERANCE_VIOLATED),
        (on_path(0.05), 1.5, -0.06, goals.PATH_TOLERANCE_VIOLATED),
        (on_path(0.05), 1.5, 0.04, None),
        (on_path(0.0), 1.5, 3.0, None),
        (on_path(-1.0), 1.5, 3.0, None),
        (AT_END, 2.0, 0.01, goals.SUCCESSFUL),
        (AT_END, 2.5, 0.06, None),
        (AT_END, 2.6, 0.06, goals.GOAL_TOLERANCE_VIOLATED),
        (AT_END, 2.6, 0.05, goals.SUCCESSFUL),
    ],
)
def test_what_falls_behind_its_path_and_the_goals_own_tolerance_and_time(
    tolerance: dict[str, Any], at_s: float, behind_rad: float, code: int | None
) -> None:
    followed = follow(replace(WAY, **tolerance))
    judged = followed.judge(sent(followed, NOW_S + at_s, behind_rad), NOW_S + at_s)
    assert (judged and judged.error_code) == code
    if judged is not None and code == goals.PATH_TOLERANCE_VIOLATED:
        assert judged.error_string == "joint_11 is 0.06 rad from its plan, more than 0.05"
    not_started = GoalProgress(followed.plan.at(NOW_S + 1), {})
    assert followed.judge(not_started, NOW_S + min(at_s, 2.0)) is None, "legs start one after the other"
    assert followed.positions(not_started) is None


def test_feedback_has_the_goals_order_of_joints() -> None:
    followed = follow(WAY)
    found = followed.positions(sent(followed, NOW_S + 1.5, behind_rad=0.05))
    assert found is not None
    assert followed.names == GOALS_LEG
    assert found[0] == pytest.approx((-1.5, 0.2, 0.5))
    assert found[1] == pytest.approx((-1.5, 0.15, 0.5))


@pytest.mark.parametrize(
    ("goal", "code", "why"),
    [
        (goal_of((1, 0.0), names=("a", "b", "c")), goals.INVALID_JOINTS, "no joint 'a'"),
        (goal_of((1, 9.0)), goals.INVALID_GOAL, "joint_11 at 9 rad"),
        (goal_of((1, 0.0), begins_s=-2), goals.OLD_HEADER_TIMESTAMP, "over 1.0 s ago"),
        (goal_of((1, 0.0), begins_s=-999_999), goals.OLD_HEADER_TIMESTAMP, "does its clock agree"),
        (replace(WAY, path_tolerance=(JointTolerance("joint_21", 0.1),)), goals.INVALID_JOINTS, "for 'joint_21'"),
        (replace(WAY, goal_tolerance=(JointTolerance("joint_11", math.nan),)), goals.INVALID_GOAL, "joint_11 is nan"),
        (replace(WAY, goal_tolerance=(JointTolerance("joint_11", -2.0),)), goals.INVALID_GOAL, "joint_11 is -2.0"),
        (
            replace(WAY, multi_dof_trajectory=MultiDOFJointTrajectory(points=(object(),))),
            goals.INVALID_GOAL,
            "one degree of freedom",
        ),
    ],
)
def test_why_a_goal_cannot_be_followed(goal: Message, code: int, why: str) -> None:
    with pytest.raises(JointsError, match=why) as caught:
        follow(goal)
    assert error_code(caught.value) == code


# ---- what examples/ros2 configures


FOLDER: Final = Path(__file__).parents[3] / "examples/ros2"
"""Priorities and seconds, as elkapod_core has them."""


def test_what_twist_mux_publishes_is_what_the_bridge_takes() -> None:
    """By DDS a topic has one type: cmd_vel is a Twist."""
    found = YAML(typ="safe").load(FOLDER / "twist_mux.yaml")
    assert found.keys() == {"twist_mux"}
    assert found["twist_mux"]["ros__parameters"]["use_stamped"] is False
    assert "-r cmd_vel_out:=/hexapod/cmd_vel" in (FOLDER / "twist_mux.yaml").read_text()
