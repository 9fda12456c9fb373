"""A goal of FollowJointTrajectory: how far it is, and how it ends. Pure.

As joint_trajectory_controller has it: a cancelled one holds where it is. Nothing comes back from the servos, so
`actual` is what was sent, and a tolerance is exceeded where sending falls behind.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from gateway.people.ros2.joints import JointNames, JointsError, NamesError
from gateway.people.ros2.messages import (
    Duration,
    FollowFeedback,
    FollowGoal,
    FollowResult,
    Header,
    JointTolerance,
    JointTrajectoryPoint,
    Time,
)
from gateway.people.ros2.trajectory import OverError, Trajectory, seconds

_SENT_RAD: Final = 1e-6
"""Without a tolerance, the last point itself has to be sent; this is what rounding may add."""
REPLACED: Final = FollowResult(FollowResult.INVALID_GOAL, "a new goal has replaced it")
CANCELLED: Final = FollowResult(FollowResult.SUCCESSFUL, "cancelled on request; it holds where it is")


class GoalProgress(NamedTuple):
    """How far a trajectory is."""

    desired_rad: Mapping[int, float]
    """By its plan, now."""
    sent_rad: Mapping[int, float]
    """Of the joints that run."""
    ended: str = ""
    """Why it is not followed any more; one sentence."""


class Followed:
    """One goal that is followed."""

    def __init__(self, goal: FollowGoal, names: JointNames, plan: Trajectory) -> None:
        """Raises JointsError where a tolerance cannot be kept, or is for a joint that the goal does not move."""
        if goal.multi_dof_trajectory.points:
            raise JointsError("it has a multi_dof_trajectory; a joint here has one degree of freedom")
        self.plan = plan
        self._names = goal.trajectory.joint_names
        self._servos = names.servos(self._names)
        by_name = dict(zip(self._names, self._servos, strict=True))
        self._path = _tolerances(by_name, goal.path_tolerance)
        self._goal = _tolerances(by_name, goal.goal_tolerance)
        self._late_s = seconds(goal.goal_time_tolerance)

    def feedback(self, progress: GoalProgress, now_s: float, stamp: Time) -> FollowFeedback | None:
        """None until all its joints run: before that nobody knows where they are."""
        desired, sent = progress.desired_rad, progress.sent_rad
        if not all(servo_id in desired and servo_id in sent for servo_id in self._servos):
            return None
        elapsed = _duration(self.plan.elapsed_s(now_s))

        def point(at: Callable[[int], float]) -> JointTrajectoryPoint:
            return JointTrajectoryPoint(tuple(map(at, self._servos)), time_from_start=elapsed)

        error = point(lambda servo_id: desired[servo_id] - sent[servo_id])
        return FollowFeedback(Header(stamp), self._names, point(desired.__getitem__), point(sent.__getitem__), error)

    def judge(self, progress: GoalProgress, now_s: float) -> FollowResult | None:
        """Its result, or None while it goes on."""
        if progress.ended:
            return FollowResult(FollowResult.INVALID_GOAL, progress.ended)
        if now_s < self.plan.ends_s:
            running = {servo_id: most for servo_id, most in self._path.items() if servo_id in progress.sent_rad}
            late = self._exceeding(progress, running, math.inf)
            return FollowResult(FollowResult.PATH_TOLERANCE_VIOLATED, late) if late else None
        late = self._exceeding(progress, self._goal, _SENT_RAD)
        if not late:
            return FollowResult(FollowResult.SUCCESSFUL, "its last point is reached")
        if 0 < self._late_s < now_s - self.plan.ends_s:
            return FollowResult(FollowResult.GOAL_TOLERANCE_VIOLATED, late)
        return None

    def _exceeding(self, progress: GoalProgress, tolerances: Mapping[int, float], otherwise: float) -> str:
        """The first joint that is further off than its tolerance, as a sentence, or nothing."""
        for name, servo_id in zip(self._names, self._servos, strict=True):
            most = tolerances.get(servo_id, otherwise)
            off = abs(progress.desired_rad[servo_id] - progress.sent_rad.get(servo_id, math.inf))
            if off > most:  # one that does not run yet is infinitely far off
                return f"{name} is {off:.3g} rad from its plan, more than {most:.3g}"
        return ""


def error_code(error: Exception) -> int:
    """Which result says why a goal cannot be followed."""
    if isinstance(error, NamesError):
        return FollowResult.INVALID_JOINTS
    return FollowResult.OLD_HEADER_TIMESTAMP if isinstance(error, OverError) else FollowResult.INVALID_GOAL


def _tolerances(servos: Mapping[str, int], found: tuple[JointTolerance, ...]) -> dict[int, float]:
    """Servo → radians. 0 is none given, and -1 none at all; velocities and accelerations are not measured."""
    tolerances = {}
    for each in found:
        if each.name not in servos:
            raise NamesError(f"there is a tolerance for {each.name[:64]!r}, which the goal does not move")
        if not (math.isfinite(each.position) and (each.position >= 0 or each.position == -1)):
            raise JointsError(f"the tolerance of {each.name} is {each.position}")
        if each.position:
            tolerances[servos[each.name]] = each.position if each.position > 0 else math.inf
    return tolerances


def _duration(total_s: float) -> Duration:
    whole = math.floor(total_s)
    return Duration(whole, min(int((total_s - whole) * 1e9), 999_999_999))
