"""The action follow_joint_trajectory: its services and topics around `Goals`, and the trajectory that is followed.

A goal is rejected while nobody has called `drive`. One that cannot be followed is accepted and aborted at once, since
only a result has a code and a sentence.
"""

import threading
import time
from collections.abc import Callable
from typing import Final, TypeVar

from gateway.geometry import Geometry
from gateway.people.bridge.driving import Driving, NotTakenError
from gateway.people.bridge.graph import Arrived, Graph, Reply, Respond, presence
from gateway.people.bridge.topics import MAX_TRAJECTORY_BYTES, Topics
from gateway.people.ros2.actions import (
    CANCEL_GOAL,
    GET_RESULT,
    SEND_GOAL,
    UUID,
    CancelGoalRequest,
    CancelGoalResponse,
    FollowFeedbackMessage,
    FollowGetResultRequest,
    FollowGetResultResponse,
    FollowResult,
    FollowSendGoalRequest,
    FollowSendGoalResponse,
    GoalStatus,
    GoalStatusArray,
)
from gateway.people.ros2.cdr import CdrError, Message, decode
from gateway.people.ros2.goals import CANCELLED, Followed, Goals, error_code
from gateway.people.ros2.joints import JointNames, JointsError
from gateway.people.ros2.messages import Time
from gateway.people.ros2.trajectory import Trajectory

NAME: Final = "follow_joint_trajectory"
FEEDBACK_S: Final = 0.05
"""As joint_trajectory_controller's action_monitor_rate: 20 Hz."""
_MAX_BYTES: Final = 4096
_MOST_WAITING: Final = 64
"""Requests for the result of the goal that is followed; of more, the oldest are answered without it."""
M = TypeVar("M", bound=Message)


class FollowAction:
    """For any thread. `tick` waits for nothing."""

    def __init__(self, graph: Graph, driving: Driving, geometry: Geometry, joints: JointNames, topics: Topics) -> None:
        """Raises ConfigError where the graph does not have the action's types."""
        self._driving = driving
        self._geometry = geometry
        self._joints = joints
        self._topics = topics
        self._lock = threading.Lock()
        self._goals = Goals()
        self._followed: Followed | None = None
        self._waiting: list[tuple[UUID, Reply]] = []
        self._fed_s = 0.0
        self._feedback = graph.publisher(f"{NAME}/_action/feedback", FollowFeedbackMessage)
        self._status = graph.publisher(f"{NAME}/_action/status", GoalStatusArray, latched=True)
        self._callers = graph.callers(f"{NAME}/_action/send_goal")

        def serve(name: str, kind: tuple[str, str], most_bytes: int, respond: Respond) -> None:
            graph.respond(f"{NAME}/_action/{name}", kind, most_bytes, respond)

        rejected = CancelGoalResponse(CancelGoalResponse.ERROR_REJECTED)
        unknown = FollowGetResultResponse(GoalStatus.STATUS_UNKNOWN)
        send = self._reading(FollowSendGoalRequest, self._send, FollowSendGoalResponse())
        serve("send_goal", SEND_GOAL, MAX_TRAJECTORY_BYTES, send)
        serve("get_result", GET_RESULT, _MAX_BYTES, self._reading(FollowGetResultRequest, self._result, unknown))
        serve("cancel_goal", CANCEL_GOAL, _MAX_BYTES, self._reading(CancelGoalRequest, self._cancel, rejected))

    def tick(self) -> None:
        """Fifty times a second: publish how far it is, and end what has ended."""
        if self._followed is not None and self._lock.acquire(blocking=False):
            try:
                self._look(self._followed, time.monotonic())
            finally:
                self._lock.release()

    # ---- services

    def _reading(self, kind: type[M], answer: Callable[[M, Arrived, Reply], None], otherwise: Message) -> Respond:
        """Decode a request; one that cannot be read has the answer `otherwise`."""

        def respond(arrived: Arrived, reply: Reply) -> None:
            try:
                request = decode(kind, arrived.data)
            except CdrError as error:
                self._topics.reject(NAME, str(error))
                reply(otherwise)
            else:
                answer(request, arrived, reply)

        return respond

    def _send(self, request: FollowSendGoalRequest, arrived: Arrived, reply: Reply) -> None:
        with self._lock:
            stamp = _now()
            try:
                self._begin(request, arrived, stamp)
            except NotTakenError as error:
                self._topics.reject(NAME, str(error))
                reply(FollowSendGoalResponse())
            else:
                reply(FollowSendGoalResponse(True, stamp))
                self._publish()

    def _begin(self, request: FollowSendGoalRequest, arrived: Arrived, stamp: Time) -> None:
        """Raises NotTakenError where it is to be rejected."""
        if not self._driving.drives:
            raise NotTakenError(self._driving.does)
        if self._goals.knows(request.goal_id):
            raise NotTakenError("an earlier goal has this id")
        self._topics.check_age(arrived)
        is_there = presence(arrived.sender, self._callers)
        goal = request.goal
        try:
            if not is_there():
                raise JointsError("its sender is not seen in the graph (any more), and could not cancel it")
            plan = Trajectory.read(goal.trajectory, self._joints, self._geometry, time.monotonic(), time.time_ns())
            followed = Followed(goal, self._joints, plan)
            self._driving.follow(plan, is_there)
        except (JointsError, NotTakenError) as error:
            self._topics.reject(NAME, str(error))
            self._goals.refuse(request.goal_id, stamp, FollowResult(error_code(error), str(error)))
        else:
            self._topics.taken[NAME] += 1
            self._goals.begin(request.goal_id, stamp)
            self._followed = followed

    def _result(self, request: FollowGetResultRequest, _: Arrived, reply: Reply) -> None:
        with self._lock:
            self._waiting.append((request.goal_id, reply))
            self._answer()

    def _cancel(self, request: CancelGoalRequest, _: Arrived, reply: Reply) -> None:
        with self._lock:
            response = self._goals.cancels(request)
            if response.return_code == CancelGoalResponse.ERROR_NONE:
                self._end(GoalStatus.STATUS_CANCELED, CANCELLED)
            reply(response)
            self._publish()

    # ---- inside, with the lock

    def _look(self, followed: Followed, now_s: float) -> None:
        goal_id = self._goals.active
        if goal_id is None or followed is not self._followed:  # it has ended since
            return
        progress = self._driving.progress(followed.plan)
        feedback = followed.feedback(goal_id, progress, now_s, _now())
        if feedback is not None and now_s - self._fed_s >= FEEDBACK_S:
            self._fed_s = now_s
            self._feedback.publish(feedback)
        judged = followed.judge(progress, now_s)
        if judged is not None:
            self._end(*judged)
            self._publish()

    def _end(self, status: int, result: FollowResult) -> None:
        """Unless it has reached its end, it holds where it is."""
        if self._followed is not None and status != GoalStatus.STATUS_SUCCEEDED:
            self._driving.hold(self._followed.plan)
        self._goals.end(status, result)
        self._followed = None

    def _publish(self) -> None:
        self._status.publish(self._goals.statuses())
        self._answer()

    def _answer(self) -> None:
        """All who wait for a result that there is, and the oldest of too many."""
        waiting, self._waiting = self._waiting, []
        for number, (goal_id, reply) in enumerate(waiting):
            found = self._goals.result(goal_id)
            if found is None and len(waiting) - number > _MOST_WAITING:
                found = FollowGetResultResponse(GoalStatus.STATUS_UNKNOWN)
            if found is None:
                self._waiting.append((goal_id, reply))
            else:
                reply(found)


def _now() -> Time:
    return Time(*divmod(time.time_ns(), 1_000_000_000))
