"""The action follow_joint_trajectory: rclpy's action server around a trajectory that is followed.

A goal is rejected while nobody has called `drive`. One that cannot be followed is accepted and aborted at once, since
only a result has a code and a sentence. A new goal replaces the one before, which is aborted.
"""

import threading
import time
from typing import Any, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration

from gateway.people.ros2.driving import NotTakenError
from gateway.people.ros2.goals import CANCELLED, REPLACED, SUCCESSFUL, Followed, GoalResult, error_code
from gateway.people.ros2.node import ros_type
from gateway.people.ros2.received import presence
from gateway.people.ros2.topics import Topics
from gateway.people.ros2.trajectory import JointsError

NAME: Final = "follow_joint_trajectory"
FEEDBACK_S: Final = 0.05
"""The period of feedback, as joint_trajectory_controller's action_monitor_rate: 20 Hz."""
_RESULT_KEPT_S: Final = 60
"""How long the result of an ended goal is kept."""


class FollowAction:
    """The action server. The executor calls it, on one thread for each goal until it ends."""

    def __init__(self, topics: Topics) -> None:
        """Raises ConfigError if this ROS 2 has no control_msgs."""
        self._topics = topics
        self._lock = threading.Lock()
        self._newest: Any = None
        """The handle of the goal that is followed."""
        self._type = ros_type("control_msgs/action/FollowJointTrajectory")
        self._point = ros_type("trajectory_msgs/msg/JointTrajectoryPoint")
        self._callers = topics.node.callers(f"{NAME}/_action/send_goal")
        self._server = ActionServer(
            topics.node,
            self._type,
            NAME,
            self._execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=self._may_begin,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=_RESULT_KEPT_S,
        )

    def _may_begin(self, _: Any) -> Any:
        if self._topics.driving.drives:
            return GoalResponse.ACCEPT
        self._topics.reject(NAME, self._topics.driving.does)
        return GoalResponse.REJECT

    def _execute(self, handle: Any) -> Any:
        """Follow a goal to its end, and return its result. If it cannot begin, the goal before it continues."""
        is_there = presence(b"", self._callers)
        try:
            with self._lock:
                if not is_there():
                    raise JointsError("its sender is not seen in the graph (any more), and could not cancel it")
                plan = self._topics.plan(handle.request.trajectory)
                followed = Followed(handle.request, self._topics.joints, plan)
                self._topics.driving.follow(plan, is_there)
                self._newest = handle
        except (JointsError, NotTakenError) as error:
            self._topics.reject(NAME, str(error))
            ends, result = handle.abort, GoalResult(error_code(error), str(error))
        else:
            self._topics.taken[NAME] += 1
            ends, result = self._follow(handle, followed)
            if ends is not handle.succeed:
                self._topics.driving.hold(followed.plan)
        ends()
        return self._type.Result(**result._asdict())

    def _follow(self, handle: Any, followed: Followed) -> tuple[Any, GoalResult]:
        """Wait for the end of the goal, and return its result."""
        while True:
            now_s = time.monotonic()
            progress = self._topics.driving.progress(followed.plan)
            if handle.is_cancel_requested:
                return handle.canceled, CANCELLED
            if handle is not self._newest:
                return handle.abort, REPLACED
            if (positions := followed.positions(progress)) is not None:
                handle.publish_feedback(self._feedback(followed, *positions, now_s))
            result = followed.judge(progress, now_s)
            if result is not None:
                return handle.succeed if result.error_code == SUCCESSFUL else handle.abort, result
            time.sleep(FEEDBACK_S)

    def _feedback(self, followed: Followed, desired: list[float], actual: list[float], now_s: float) -> Any:
        elapsed = Duration(seconds=followed.plan.elapsed_s(now_s)).to_msg()
        error = [there - here for there, here in zip(desired, actual, strict=True)]
        ways = {"desired": desired, "actual": actual, "error": error}
        points = {name: self._point(positions=way, time_from_start=elapsed) for name, way in ways.items()}
        feedback = self._type.Feedback(joint_names=followed.names, **points)
        feedback.header.stamp = self._topics.node.get_clock().now().to_msg()
        return feedback
