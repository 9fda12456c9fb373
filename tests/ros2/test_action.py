"""FollowJointTrajectory over Zenoh, by its bytes: a goal's way to its result, and what ends one before."""

import itertools
import threading
import time
import uuid
from collections.abc import Iterator
from typing import Any, Final

import pytest

from gateway.client import Client
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
    FollowGoal,
    FollowResult,
    FollowSendGoalRequest,
    FollowSendGoalResponse,
    GoalInfo,
    GoalStatus,
    GoalStatusArray,
)
from gateway.people.ros2.cdr import Message, decode, encode
from gateway.people.ros2.messages import JointTrajectory
from gateway.people.ros2.wire import CALLS, QOS, Attachment, gid_of
from schemas.telemetry import Mode
from tests.ros2.test_motion import plan
from tests.support.bridged import LONG_S, RESTS_DEG, Bridge, Received, commanded, keeps
from tests.support.heard import frames, running, states

NAME: Final = "follow_joint_trajectory/_action/"
ANSWERS: Final[dict[str, tuple[tuple[str, str], type[Message]]]] = {
    "send_goal": (SEND_GOAL, FollowSendGoalResponse),
    "get_result": (GET_RESULT, FollowGetResultResponse),
    "cancel_goal": (CANCEL_GOAL, CancelGoalResponse),
}


class ActionClient:
    """One as rcl_action has it over rmw_zenoh."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._numbers = itertools.count(1)
        session, (type_name, type_hash) = bridge.router, SEND_GOAL
        shown = bridge.names.token(str(session.zid()), 2, CALLS, f"{NAME}send_goal", type_name, type_hash, QOS)
        self._gid = gid_of(shown)
        self._token: Any = session.liveliness().declare_token(shown)

    def vanish(self) -> None:
        """As when its process has died."""
        token, self._token = self._token, None
        if token is not None:
            token.undeclare()

    def send(self, trajectory: JointTrajectory, **options: Any) -> UUID:
        """A goal that is accepted."""
        goal_id, accepted = self.offer(trajectory, **options)
        assert accepted
        return goal_id

    def offer(self, trajectory: JointTrajectory, **options: Any) -> tuple[UUID, bool]:
        goal_id = UUID(tuple(uuid.uuid4().bytes))
        return goal_id, self.ask(
            "send_goal", FollowSendGoalRequest(goal_id, FollowGoal(trajectory, **options))
        ).accepted

    def result(self, goal_id: UUID) -> tuple[int, FollowResult]:
        """Status and result, once the goal has ended."""
        found = self.ask("get_result", FollowGetResultRequest(goal_id))
        return found.status, found.result

    def cancel(self, goal_id: UUID) -> Any:
        return self.ask("cancel_goal", CancelGoalRequest(GoalInfo(goal_id)))

    def ask(self, service: str, request: Message) -> Any:
        kind, answer = ANSWERS[service]
        asked = Attachment(next(self._numbers), time.time_ns(), self._gid)
        (reply,) = self._bridge.call(
            service,
            self._bridge.names.key(f"{NAME}{service}", *kind),
            payload=encode(request),
            attachment=asked.to_bytes(),
        )
        assert reply.ok is not None, reply.err and reply.err.payload.to_string()
        assert reply.ok.attachment is not None
        answered = Attachment.from_bytes(reply.ok.attachment.to_bytes())
        assert (answered.number, answered.gid) == (asked.number, asked.gid)
        return decode(answer, reply.ok.payload.to_bytes())


@pytest.fixture
def client(bridge: Bridge) -> Iterator[ActionClient]:
    found = ActionClient(bridge)
    yield found
    found.vanish()


SLOW: Final = plan((0.5, 0.0), (55.0, 1.0))


def test_a_goal_is_followed_with_feedback_to_its_result(driven: Bridge, client: ActionClient, watcher: Client) -> None:
    feedback = Received(driven, f"{NAME}feedback", FollowFeedbackMessage)
    status = Received(driven, f"{NAME}status", GoalStatusArray)
    written = frames(watcher)
    goal_id = client.send(plan((0.5, 0.0), (1.5, 0.3)))
    assert status.wait(lambda _: True).status_list[-1].status == GoalStatus.STATUS_EXECUTING
    seen = feedback.wait(lambda each: each.feedback.actual.positions[0] > each.feedback.actual.positions[3] + 0.1)
    assert seen.goal_id == goal_id
    assert seen.feedback.joint_names == SLOW.joint_names
    assert seen.feedback.desired.positions[0] == pytest.approx(
        seen.feedback.actual.positions[0] + seen.feedback.error.positions[0]
    )
    assert client.result(goal_id) == (
        GoalStatus.STATUS_SUCCEEDED,
        FollowResult(FollowResult.SUCCESSFUL, "its last point is reached"),
    )
    assert len(running(watcher)) == 6, "its last point is held"
    assert commanded(written.all, 11)[-1] == pytest.approx(RESTS_DEG[1] + 17.19, abs=0.01)
    assert status.wait(lambda each: each.status_list[-1].status == GoalStatus.STATUS_SUCCEEDED)
    assert client.cancel(goal_id).return_code == CancelGoalResponse.ERROR_GOAL_TERMINATED


def test_a_goal_that_is_cancelled_holds_where_it_is(driven: Bridge, client: ActionClient, watcher: Client) -> None:
    del driven
    written = frames(watcher)
    goal_id = client.send(SLOW)
    keeps(lambda: None, lambda: len(set(commanded(written.all, 11))) > 5)
    assert client.cancel(UUID((1,) * 16)).return_code == CancelGoalResponse.ERROR_UNKNOWN_GOAL_ID
    assert client.cancel(goal_id).return_code == CancelGoalResponse.ERROR_NONE
    assert client.result(goal_id)[0] == GoalStatus.STATUS_CANCELED
    count = len(commanded(written.all, 11))
    keeps(lambda: None, lambda: len(commanded(written.all, 11)) > count + 20)
    assert len(set(commanded(written.all, 11)[count + 2 :])) == 1
    assert len(running(watcher)) == 6


def test_a_new_goal_cancels_the_one_before_and_a_bad_one_does_not(driven: Bridge, client: ActionClient) -> None:
    del driven
    first = client.send(SLOW)
    bad = client.send(JointTrajectory(joint_names=("gripper",), points=SLOW.points))
    status, result = client.result(bad)
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, FollowResult.INVALID_JOINTS)
    assert "there is no joint 'gripper'" in result.error_string
    then = client.send(SLOW)
    assert client.result(first) == (
        GoalStatus.STATUS_CANCELED,
        FollowResult(FollowResult.INVALID_GOAL, "a new goal has replaced it"),
    )
    assert client.cancel(UUID()).goals_canceling[0].goal_id == then, "nil: all goals"


def test_an_emergency_stop_aborts_a_goal_with_a_sentence(driven: Bridge, client: ActionClient, watcher: Client) -> None:
    del driven
    goal_id = client.send(SLOW)
    keeps(lambda: None, lambda: len(running(watcher)) == 6)
    found: list[tuple[int, FollowResult]] = []
    waiting = threading.Thread(target=lambda: found.append(client.result(goal_id)))
    waiting.start()
    seen = states(watcher)
    watcher.estop()
    waiting.join(LONG_S)
    ((status, result),) = found
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, FollowResult.INVALID_GOAL)
    assert "emergency stop" in result.error_string
    seen.wait(lambda state: state.lease.holder is None)
    assert watcher.reset().accepted
    assert client.offer(SLOW)[1] is False, "after that somebody must call drive again"
    assert not running(watcher)


def test_a_client_that_vanishes_has_the_robot_sit_down(driven: Bridge, client: ActionClient, watcher: Client) -> None:
    del driven
    goal_id = client.send(SLOW)
    keeps(lambda: None, lambda: len(running(watcher)) == 6)
    client.vanish()
    status, result = client.result(goal_id)
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, FollowResult.INVALID_GOAL)
    assert result.error_string == "its sender has left the graph, so the robot sits down"
    states(watcher).wait(lambda state: state.mode == Mode.IDLE, timeout_s=LONG_S)


def test_what_is_no_request_moves_nothing(driven: Bridge, client: ActionClient, watcher: Client) -> None:
    before = watcher.state().commands
    key = driven.names.key(f"{NAME}send_goal", *SEND_GOAL)
    (reply,) = driven.call("send_goal", key, payload=encode(FollowSendGoalRequest()))
    assert reply.err is not None
    assert "no attachment" in reply.err.payload.to_string()
    asked = Attachment(1, time.time_ns(), bytes(16)).to_bytes()
    (reply,) = driven.call("send_goal", key, payload=bytes(1_000_001), attachment=asked)
    assert reply.err is not None
    assert "at most 1000000 are taken" in reply.err.payload.to_string()
    (reply,) = driven.call("send_goal", key, payload=b"\0\1\0\0\1", attachment=asked)
    assert reply.ok is not None
    assert not decode(FollowSendGoalResponse, reply.ok.payload.to_bytes()).accepted
    assert client.result(UUID((7,) * 16))[0] == GoalStatus.STATUS_UNKNOWN
    assert watcher.state().commands == before
