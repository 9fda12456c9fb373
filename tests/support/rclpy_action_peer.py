"""A client of the action follow_joint_trajectory: rclpy's own ActionClient, in a process that has control_msgs."""

import pickle
import sys
import threading
from importlib import import_module
from typing import Any

from tests.support.rclpy_peer import ANSWER_S, DOMAIN, RclpyPeer, act
from tests.support.rclpy_peer import Actor as RclpyActor

NAME = "/hexapod/follow_joint_trajectory"


class ActionPeer(RclpyPeer):
    """The end that a test holds; goals are numbered from 0."""

    def __init__(self, env: dict[str, str], domain: int = DOMAIN) -> None:
        super().__init__(domain, "tests.support.rclpy_action_peer", **env)

    def feedback(self) -> tuple[list[float], list[float], list[float]]:
        """The next: desired, actual and error."""
        desired, actual, error = self._ask("next", NAME)
        return desired, actual, error


class Actor(RclpyActor):
    """The end inside the process; each public method is a command."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self._type = import_module("control_msgs.action").FollowJointTrajectory
        self._client = import_module("rclpy.action").ActionClient(self._node, self._type, NAME)
        self._handles: list[Any] = []
        self._results: list[Any] = []

    def send(self, packed_goal: str) -> bool:
        """Whether it is accepted."""
        if not self._client.wait_for_server(ANSWER_S / 2):
            raise TimeoutError(f"nobody serves {NAME}")
        fields = vars(pickle.loads(bytes.fromhex(packed_goal)))  # noqa: S301 - our own test's
        value_of = import_module("gateway.people.ros2.node").to_ros
        goal = self._type.Goal(**{name: value_of(value) for name, value in fields.items()})
        handle = self._done(self._client.send_goal_async(goal, feedback_callback=self._feed))
        self._handles.append(handle)
        self._results.append(handle.get_result_async() if handle.accepted else None)
        return bool(handle.accepted)

    def cancel(self, number: int) -> int:
        """How many goals are cancelled."""
        return len(self._done(self._handles[number].cancel_goal_async()).goals_canceling)

    def result(self, number: int) -> tuple[int, int, str]:
        """Status, code and sentence, once it has ended."""
        found = self._done(self._results[number])
        return found.status, found.result.error_code, found.result.error_string

    def _feed(self, message: Any) -> None:
        found = message.feedback
        self._received[NAME].put([list(each.positions) for each in (found.desired, found.actual, found.error)])

    def _done(self, future: Any) -> Any:
        ended = threading.Event()
        future.add_done_callback(lambda _: ended.set())
        if not ended.wait(ANSWER_S):
            raise TimeoutError("no answer")
        return future.result()


if __name__ == "__main__":
    act(Actor(int(sys.argv[1])))
