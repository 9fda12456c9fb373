"""A goal of FollowJointTrajectory: its progress and its result. Pure.

As in joint_trajectory_controller, a cancelled goal holds where it is. Nothing comes back from the servos, so
`actual` is what was sent, and a tolerance is exceeded where sending falls behind.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from gateway.people.ros2.trajectory import JointNames, JointsError, NamesError, OverError, Trajectory, seconds

_SENT_RAD: Final = 1e-6
"""Without a tolerance the last point itself must be sent, to within rounding."""
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS = 0, -1, -2
OLD_HEADER_TIMESTAMP, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = -3, -4, -5


class GoalResult(NamedTuple):
    """Result of a goal that has ended, with FollowJointTrajectory's fields."""

    error_code: int
    error_string: str


REPLACED: Final = GoalResult(INVALID_GOAL, "a new goal has replaced it")
CANCELLED: Final = GoalResult(SUCCESSFUL, "cancelled on request; it holds where it is")


class GoalProgress(NamedTuple):
    """Progress of a trajectory: angles in radians by servo."""

    desired_rad: Mapping[int, float]
    """The present angles by the plan."""
    sent_rad: Mapping[int, float]
    """The angles that were sent to running joints."""
    ended: str = ""
    """Why the trajectory is no longer followed, in one sentence; empty while followed."""


class Followed:
    """One goal that is followed."""

    def __init__(self, goal: Any, names: JointNames, plan: Trajectory) -> None:
        """Raises JointsError if a tolerance is invalid, or names a joint that the goal does not move."""
        if goal.multi_dof_trajectory.points:
            raise JointsError("it has a multi_dof_trajectory; a joint here has one degree of freedom")
        self.plan = plan
        self.names: Sequence[str] = goal.trajectory.joint_names
        self._servos = names.servos(self.names)
        by_name = dict(zip(self.names, self._servos, strict=True))
        self._path = _tolerances(by_name, goal.path_tolerance)
        self._goal = _tolerances(by_name, goal.goal_tolerance)
        self._late_s = seconds(goal.goal_time_tolerance)

    def positions(self, progress: GoalProgress) -> tuple[list[float], list[float]] | None:
        """Return desired and sent radians in the goal's order; None until all joints run."""
        desired, sent = progress.desired_rad, progress.sent_rad
        if not all(servo_id in desired and servo_id in sent for servo_id in self._servos):
            return None
        return [desired[servo_id] for servo_id in self._servos], [sent[servo_id] for servo_id in self._servos]

    def judge(self, progress: GoalProgress, now_s: float) -> GoalResult | None:
        """Return the goal's result, or None while the goal continues. `now_s`: by the plan's clock."""
        if progress.ended:
            return GoalResult(INVALID_GOAL, progress.ended)
        if now_s < self.plan.ends_s:
            running = {servo_id: most for servo_id, most in self._path.items() if servo_id in progress.sent_rad}
            late = self._exceeding(progress, running, math.inf)
            return GoalResult(PATH_TOLERANCE_VIOLATED, late) if late else None
        late = self._exceeding(progress, self._goal, _SENT_RAD)
        if not late:
            return GoalResult(SUCCESSFUL, "its last point is reached")
        if 0 < self._late_s < now_s - self.plan.ends_s:
            return GoalResult(GOAL_TOLERANCE_VIOLATED, late)
        return None

    def _exceeding(self, progress: GoalProgress, tolerances: Mapping[int, float], otherwise: float) -> str:
        """Return a sentence about the first joint beyond its tolerance; "" if none is."""
        for name, servo_id in zip(self.names, self._servos, strict=True):
            most = tolerances.get(servo_id, otherwise)
            off = abs(progress.desired_rad[servo_id] - progress.sent_rad.get(servo_id, math.inf))
            if off > most:  # one that does not run yet is infinitely far off
                return f"{name} is {off:.3g} rad from its plan, more than {most:.3g}"
        return ""


def error_code(error: Exception) -> int:
    """Return the result code for a goal that cannot be followed."""
    if isinstance(error, NamesError):
        return INVALID_JOINTS
    return OLD_HEADER_TIMESTAMP if isinstance(error, OverError) else INVALID_GOAL


def _tolerances(servos: Mapping[str, int], found: Sequence[Any]) -> dict[int, float]:
    """Servo → radians. 0 means not given, -1 no limit. Velocities and accelerations are not measured."""
    tolerances = {}
    for each in found:
        if each.name not in servos:
            raise NamesError(f"there is a tolerance for {each.name[:64]!r}, which the goal does not move")
        if not (math.isfinite(each.position) and (each.position >= 0 or each.position == -1)):
            raise JointsError(f"the tolerance of {each.name} is {each.position}")
        if each.position:
            tolerances[servos[each.name]] = each.position if each.position > 0 else math.inf
    return tolerances
