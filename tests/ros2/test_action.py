"""The action follow_joint_trajectory over FastDDS: rclpy's own ActionClient, with types by ROS 2's own generators."""

import shutil
from collections.abc import Iterator

import pytest

from gateway.client import Client
from gateway.people.ros2 import goals
from tests.support.bridged import RESTS_DEG, SLOW, commanded, keeps, plan, rests
from tests.support.control_msgs import made
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, running, states
from tests.support.rclpy_action_peer import ActionPeer
from tests.support.rclpy_peer import DOMAIN, RclpyBridge, needs_rclpy
from tests.support.ros2_messages import FollowGoal, JointTrajectory

pytestmark = [
    needs_rclpy,
    pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed, which compiles control_msgs"),
]
OWN_DOMAIN = DOMAIN % 100 + 1
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""As action_msgs/GoalStatus has them."""


@pytest.fixture(scope="module")
def control_msgs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Its environment; half a minute of compiling."""
    return made(tmp_path_factory.mktemp("control_msgs"))


@pytest.fixture(scope="module")
def peer(gateway: Gateway, control_msgs: dict[str, str]) -> Iterator[ActionPeer]:
    bridge = RclpyBridge(gateway, domain=OWN_DOMAIN, env=control_msgs)
    with bridge, ActionPeer(control_msgs, OWN_DOMAIN) as found:
        yield found


def test_rclpys_own_client_sends_cancels_and_replaces_goals_and_an_emergency_stop_aborts_one(
    peer: ActionPeer, watcher: Client
) -> None:
    written = frames(watcher)
    assert not peer.send(FollowGoal(SLOW)), "nobody has called drive"
    assert peer.call("/hexapod/drive")[0]
    assert peer.send(FollowGoal(plan((0.5, 0.0), (1.5, 0.3))))
    desired, actual, error = peer.feedback()
    assert (len(desired), len(actual), len(error)) == (18, 18, 18)
    assert peer.result(1) == (SUCCEEDED, goals.SUCCESSFUL, "its last point is reached")
    assert len(running(watcher)) == 6, "its last point is held"
    last_deg = [pytest.approx(RESTS_DEG[1] + 17.19, abs=0.01)]
    written.wait(lambda record: commanded([record], 11) == last_deg)

    assert peer.send(FollowGoal(SLOW))
    assert peer.cancel(2) == 1
    assert peer.result(2) == (CANCELED, goals.SUCCESSFUL, "cancelled on request; it holds where it is")
    keeps(lambda: None, lambda: rests(written, 11, count=20))
    assert len(running(watcher)) == 6

    assert peer.send(FollowGoal(SLOW))
    assert peer.send(FollowGoal(JointTrajectory(joint_names=("gripper",), points=SLOW.points)))
    assert peer.result(4)[:2] == (ABORTED, goals.INVALID_JOINTS)
    assert peer.send(FollowGoal(SLOW))
    assert peer.result(3)[:2] == (ABORTED, goals.INVALID_GOAL)

    seen = states(watcher)
    watcher.estop()
    status, code, why = peer.result(5)
    assert (status, code) == (ABORTED, goals.INVALID_GOAL)
    assert "emergency stop" in why
    seen.wait(lambda state: state.lease.holder is None)
    assert watcher.reset().accepted
    assert not peer.send(FollowGoal(SLOW)), "after that somebody must call drive again"
    assert not running(watcher)
