"""The action follow_joint_trajectory: rclpy's action server around a trajectory that is followed.

A goal is rejected while nobody has called `drive`. One that cannot be followed is accepted and aborted at once, since
only a result has a code and a sentence. A new goal replaces the one before, which is aborted.
"""

import threading
import time
from typing import TYPE_CHECKING, Any, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup

from gateway.geometry import Geometry
from gateway.people.bridge.driving import Driving, NotTakenError
from gateway.people.bridge.graph import presence
from gateway.people.bridge.topics import Topics
from gateway.people.bridge.values import from_ros, ros_type, to_ros
from gateway.people.ros2.goals import CANCELLED, REPLACED, Followed, error_code
from gateway.people.ros2.joints import JointNames, JointsError
from gateway.people.ros2.messages import FollowGoal, FollowResult, Time
from gateway.people.ros2.trajectory import Trajectory

if TYPE_CHECKING:
    from gateway.people.bridge.node import Node

NAME: Final = "follow_joint_trajectory"
FEEDBACK_S: Final = 0.05
"""As joint_trajectory_controller's action_monitor_rate: 20 Hz."""
_RESULT_KEPT_S: Final = 60
"""So long the result of a goal that has ended can be asked for."""


class FollowAction:
    """Called by the executor's threads: each goal has one until it ends."""

    def __init__(self, node: "Node", driving: Driving, geometry: Geometry, joints: JointNames, topics: Topics) -> None:
        """Raises ConfigError where this ROS 2 has no control_msgs."""
        self._driving = driving
        self._geometry = geometry
        self._joints = joints
        self._topics = topics
        self._lock = threading.Lock()
        self._newest: Any = None
        """The handle of the goal that is followed."""
        self._callers = node.callers(f"{NAME}/_action/send_goal")
        self._server = ActionServer(
            node,
            ros_type("control_msgs/action/FollowJointTrajectory"),
            NAME,
            self._execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=self._may_begin,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=_RESULT_KEPT_S,
        )

    def _may_begin(self, _: Any) -> Any:
        if self._driving.drives:
            return GoalResponse.ACCEPT
        self._topics.reject(NAME, self._driving.does)
        return GoalResponse.REJECT

    def _execute(self, handle: Any) -> Any:
        """Follow a goal to its end, and return its result."""
        try:
            followed = self._begin(handle)
        except (JointsError, NotTakenError) as error:
            self._topics.reject(NAME, str(error))
            handle.abort()
            return to_ros(FollowResult(error_code(error), str(error)))
        self._topics.taken[NAME] += 1
        ends, result = self._follow(handle, followed)
        if ends is not handle.succeed:
            self._driving.hold(followed.plan)
        ends()
        return to_ros(result)

    def _begin(self, handle: Any) -> Followed:
        """Raises JointsError, NotTakenError; then the goal before it goes on."""
        goal = from_ros(FollowGoal, handle.request)
        is_there = presence(b"", self._callers)
        with self._lock:
            if not is_there():
                raise JointsError("its sender is not seen in the graph (any more), and could not cancel it")
            plan = Trajectory.read(goal.trajectory, self._joints, self._geometry, time.monotonic(), time.time_ns())
            followed = Followed(goal, self._joints, plan)
            self._driving.follow(plan, is_there)
            self._newest = handle
        return followed

    def _follow(self, handle: Any, followed: Followed) -> tuple[Any, FollowResult]:
        """What ends the goal, and its result."""
        while True:
            now_s = time.monotonic()
            progress = self._driving.progress(followed.plan)
            if handle.is_cancel_requested:
                return handle.canceled, CANCELLED
            if handle is not self._newest:
                return handle.abort, REPLACED
            feedback = followed.feedback(progress, now_s, Time(*divmod(time.time_ns(), 1_000_000_000)))
            if feedback is not None:
                handle.publish_feedback(to_ros(feedback))
            result = followed.judge(progress, now_s)
            if result is not None:
                return handle.succeed if result.error_code == FollowResult.SUCCESSFUL else handle.abort, result
            time.sleep(FEEDBACK_S)
