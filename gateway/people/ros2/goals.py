"""The goals of FollowJointTrajectory: which one is followed, how far it is, and what asking for it returns. Pure.

As joint_trajectory_controller has it: a new goal cancels the one before; a cancelled one holds where it is. Nothing
comes back from the servos, so `actual` is what was sent, and a tolerance is exceeded where sending falls behind.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from gateway.people.ros2.actions import (
    UUID,
    CancelGoalRequest,
    CancelGoalResponse,
    FollowFeedback,
    FollowFeedbackMessage,
    FollowGetResultResponse,
    FollowGoal,
    FollowResult,
    GoalInfo,
    GoalStatus,
    GoalStatusArray,
    JointTolerance,
)
from gateway.people.ros2.joints import JointNames, JointsError, NamesError
from gateway.people.ros2.messages import Duration, Header, JointTrajectoryPoint, Time
from gateway.people.ros2.trajectory import OverError, Trajectory, seconds

KEPT: Final = 16
"""Of the goals that have ended, the newest: their results can be asked for, and the status lists them."""
_SENT_RAD: Final = 1e-6
"""Without a tolerance, the last point itself has to be sent; this is what rounding may add."""
_NIL: Final = UUID()
_REPLACED: Final = FollowResult(FollowResult.INVALID_GOAL, "a new goal has replaced it")
CANCELLED: Final = FollowResult(FollowResult.SUCCESSFUL, "cancelled on request; it holds where it is")


class Goals:
    """All goals that are known; at most one of them is followed."""

    def __init__(self) -> None:
        self._stamps: dict[UUID, Time] = {}
        self._ended: dict[UUID, FollowGetResultResponse] = {}
        self.active: UUID | None = None

    def knows(self, goal_id: UUID) -> bool:
        """Whether this id was used before: then another goal must not have it."""
        return goal_id in self._stamps

    def begin(self, goal_id: UUID, stamp: Time) -> None:
        """This goal is followed from now on, and the one before is not."""
        if self.active is not None:
            self.end(GoalStatus.STATUS_CANCELED, _REPLACED)
        self._stamps[goal_id] = stamp
        self.active = goal_id

    def end(self, status: int, result: FollowResult) -> None:
        """The goal that is followed has ended."""
        if self.active is None:
            raise ValueError("no goal is followed")
        goal_id, self.active = self.active, None
        self._keep(goal_id, status, result)

    def refuse(self, goal_id: UUID, stamp: Time, result: FollowResult) -> None:
        """This goal cannot be followed; the one that is goes on."""
        self._stamps[goal_id] = stamp
        self._keep(goal_id, GoalStatus.STATUS_ABORTED, result)

    def _keep(self, goal_id: UUID, status: int, result: FollowResult) -> None:
        self._ended[goal_id] = FollowGetResultResponse(status, result)
        while len(self._ended) > KEPT:
            oldest = next(iter(self._ended))
            del self._ended[oldest], self._stamps[oldest]

    def result(self, goal_id: UUID) -> FollowGetResultResponse | None:
        """Its result, or None while it is followed; STATUS_UNKNOWN for a goal that nobody knows."""
        if goal_id == self.active:
            return None
        return self._ended.get(goal_id, FollowGetResultResponse(GoalStatus.STATUS_UNKNOWN))

    def cancels(self, request: CancelGoalRequest) -> CancelGoalResponse:
        """The answer to a request to cancel; with ERROR_NONE, `end` is to follow.

        A nil id names all goals, a stamp all that were accepted until then, both nil all of them.
        """
        goal_id, until = request.goal_info.goal_id, request.goal_info.stamp
        active = self.active
        if active is not None:
            stamp = self._stamps[active]
            is_meant = goal_id in (active, _NIL) if until == Time() else goal_id == active or _until(stamp, until)
            if is_meant:
                return CancelGoalResponse(CancelGoalResponse.ERROR_NONE, (GoalInfo(active, stamp),))
        if goal_id in self._ended:
            return CancelGoalResponse(CancelGoalResponse.ERROR_GOAL_TERMINATED)
        if goal_id not in (_NIL, active):
            return CancelGoalResponse(CancelGoalResponse.ERROR_UNKNOWN_GOAL_ID)
        return CancelGoalResponse(CancelGoalResponse.ERROR_REJECTED)

    def statuses(self) -> GoalStatusArray:
        """Of all goals that are known."""
        return GoalStatusArray(
            tuple(
                GoalStatus(
                    GoalInfo(goal_id, stamp),
                    GoalStatus.STATUS_EXECUTING if goal_id == self.active else self._ended[goal_id].status,
                )
                for goal_id, stamp in self._stamps.items()
            )
        )


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

    def feedback(
        self, goal_id: UUID, progress: GoalProgress, now_s: float, stamp: Time
    ) -> FollowFeedbackMessage | None:
        """None until all its joints run: before that nobody knows where they are."""
        desired, sent = progress.desired_rad, progress.sent_rad
        if not all(servo_id in desired and servo_id in sent for servo_id in self._servos):
            return None
        elapsed = _duration(self.plan.elapsed_s(now_s))

        def point(at: Callable[[int], float]) -> JointTrajectoryPoint:
            return JointTrajectoryPoint(tuple(map(at, self._servos)), time_from_start=elapsed)

        error = point(lambda servo_id: desired[servo_id] - sent[servo_id])
        shown = FollowFeedback(Header(stamp), self._names, point(desired.__getitem__), point(sent.__getitem__), error)
        return FollowFeedbackMessage(goal_id, shown)

    def judge(self, progress: GoalProgress, now_s: float) -> tuple[int, FollowResult] | None:
        """Its status and result, or None while it goes on."""
        if progress.ended:
            return GoalStatus.STATUS_ABORTED, FollowResult(FollowResult.INVALID_GOAL, progress.ended)
        if now_s < self.plan.ends_s:
            running = {servo_id: most for servo_id, most in self._path.items() if servo_id in progress.sent_rad}
            late = self._exceeding(progress, running, math.inf)
            return _aborted(FollowResult.PATH_TOLERANCE_VIOLATED, late) if late else None
        late = self._exceeding(progress, self._goal, _SENT_RAD)
        if not late:
            return GoalStatus.STATUS_SUCCEEDED, FollowResult(FollowResult.SUCCESSFUL, "its last point is reached")
        if 0 < self._late_s < now_s - self.plan.ends_s:
            return _aborted(FollowResult.GOAL_TOLERANCE_VIOLATED, late)
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


def _aborted(code: int, why: str) -> tuple[int, FollowResult]:
    return GoalStatus.STATUS_ABORTED, FollowResult(code, why)


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


def _until(stamp: Time, until: Time) -> bool:
    return (stamp.sec, stamp.nanosec) <= (until.sec, until.nanosec)
