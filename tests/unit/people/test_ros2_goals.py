"""The goals of FollowJointTrajectory in virtual time: how far one is, and how it ends."""

import math
from typing import Final

import pytest

from gateway.geometry import load
from gateway.people.ros2 import goals
from gateway.people.ros2.goals import Followed, GoalProgress, error_code
from gateway.people.ros2.messages import Header, Message, Time
from gateway.people.ros2.trajectory import JointNames, JointsError, Trajectory
from tests.support.ros2_messages import (
    Duration,
    FollowGoal,
    JointTolerance,
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    replace,
)

GEOMETRY: Final = load()
LEG: Final = ("joint_13", "joint_11", "joint_12")
NO_STAMP: Final = Time(0, 0)


# ---- how far it is


def trajectory(*points: tuple[float, float], names: tuple[str, ...] = LEG, stamp: Message = NO_STAMP) -> Message:
    """Seconds, and radians of joint_11."""
    return JointTrajectory(
        Header(stamp),
        names,
        tuple(
            JointTrajectoryPoint((-1.5, at, 0.5), time_from_start=Duration(int(at_s), round(at_s % 1 * 1e9)))
            for at_s, at in points
        ),
    )


def read(goal: Message) -> Followed:
    """From now on, which is 100 s."""
    plan = Trajectory.read(goal.trajectory, JointNames(), GEOMETRY, 100.0, 1_000_000_000_000)
    followed = Followed(goal, JointNames(), plan)
    plan.begin({}, 100.0)
    return followed


WAY: Final = FollowGoal(trajectory((1.0, 0.0), (2.0, 0.4)))
SEVERAL_DOF: Final = MultiDOFJointTrajectory(points=(object(),))


def sent(followed: Followed, now_s: float, behind_rad: float = 0.0) -> GoalProgress:
    desired = followed.plan.at(now_s)
    return GoalProgress(desired, {**desired, 11: desired[11] - behind_rad})


def test_legs_that_do_not_run_yet_have_not_reached_it() -> None:
    followed = read(WAY)
    assert followed.judge(GoalProgress(followed.plan.at(102.0), {}), 102.0) is None
    assert followed.positions(GoalProgress(followed.plan.at(102.0), {})) is None


def test_what_ends_the_motion_aborts_the_goal() -> None:
    judged = read(WAY).judge(GoalProgress({}, {}, "the emergency stop was engaged"), 101.0)
    assert judged == goals.GoalResult(goals.INVALID_GOAL, "the emergency stop was engaged")


@pytest.mark.parametrize(
    ("position", "behind_rad", "code"),
    [
        (0.05, 0.06, goals.PATH_TOLERANCE_VIOLATED),
        (0.05, -0.06, goals.PATH_TOLERANCE_VIOLATED),
        (0.05, 0.04, None),
        (0.0, 3.0, None),
        (-1.0, 3.0, None),
    ],
)
def test_what_falls_behind_its_path(position: float, behind_rad: float, code: int | None) -> None:
    followed = read(replace(WAY, path_tolerance=(JointTolerance("joint_11", position),)))
    judged = followed.judge(sent(followed, 101.5, behind_rad), 101.5)
    assert (judged and judged.error_code) == code
    if judged is not None:
        assert judged.error_string == "joint_11 is 0.06 rad from its plan, more than 0.05"
    not_started = GoalProgress(followed.plan.at(101.5), {})
    assert followed.judge(not_started, 101.5) is None, "legs start one after the other"


@pytest.mark.parametrize(
    ("now_s", "behind_rad", "expected"),
    [
        (102.0, 0.01, goals.SUCCESSFUL),
        (102.4, 0.06, None),
        (102.5, 0.06, None),
        (102.6, 0.06, goals.GOAL_TOLERANCE_VIOLATED),
        (102.6, 0.05, goals.SUCCESSFUL),
    ],
)
def test_the_goals_own_tolerance_and_time(now_s: float, behind_rad: float, expected: object) -> None:
    tolerance = (JointTolerance("joint_11", 0.05 + 1e-9),)
    followed = read(replace(WAY, goal_tolerance=tolerance, goal_time_tolerance=Duration(0, 500_000_000)))
    judged = followed.judge(sent(followed, now_s, behind_rad), now_s)
    assert (judged and judged.error_code) == expected


def test_feedback_has_the_goals_order_of_joints() -> None:
    followed = read(WAY)
    found = followed.positions(sent(followed, 101.5, behind_rad=0.05))
    assert found is not None
    assert followed.names == LEG
    assert found[0] == pytest.approx((-1.5, 0.2, 0.5))
    assert found[1] == pytest.approx((-1.5, 0.15, 0.5))


@pytest.mark.parametrize(
    ("goal", "code", "why"),
    [
        (FollowGoal(trajectory((1, 0.0), names=("a", "b", "c"))), goals.INVALID_JOINTS, "no joint 'a'"),
        (FollowGoal(trajectory((1, 0.0), names=LEG[:2])), goals.INVALID_JOINTS, "it lacks joint_12"),
        (FollowGoal(), goals.INVALID_JOINTS, "names no joint"),
        (FollowGoal(trajectory((1, 9.0))), goals.INVALID_GOAL, "joint_11 at 9 rad"),
        (FollowGoal(trajectory((1, 0.0), stamp=Time(998, 0))), goals.OLD_HEADER_TIMESTAMP, "over 1.0 s ago"),
        (FollowGoal(trajectory((1, 0.0), stamp=Time(1, 0))), goals.OLD_HEADER_TIMESTAMP, "does its clock agree"),
        (replace(WAY, path_tolerance=(JointTolerance("joint_21", 0.1),)), goals.INVALID_JOINTS, "for 'joint_21'"),
        (replace(WAY, goal_tolerance=(JointTolerance("joint_11", math.nan),)), goals.INVALID_GOAL, "joint_11 is nan"),
        (replace(WAY, goal_tolerance=(JointTolerance("joint_11", -2.0),)), goals.INVALID_GOAL, "joint_11 is -2.0"),
        (replace(WAY, multi_dof_trajectory=SEVERAL_DOF), goals.INVALID_GOAL, "one degree of freedom"),
    ],
)
def test_why_a_goal_cannot_be_followed(goal: Message, code: int, why: str) -> None:
    with pytest.raises(JointsError, match=why) as caught:
        read(goal)
    assert error_code(caught.value) == code
