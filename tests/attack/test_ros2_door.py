"""What a stranger in ROS 2's graph does to the robot: whoever reaches it has the rights of the bridge."""

from collections.abc import Iterator

import pytest

from gateway.client import Client
from gateway.people.ros2.driving import NO_RESET
from gateway.people.ros2.messages import Twist, Vector3
from schemas.words import Mode
from tests.support.bridged import PATIENT
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import running
from tests.support.rclpy_peer import RclpyBridge, RclpyPeer, needs_rclpy

pytestmark = [needs_rclpy, pytest.mark.full]

gateway = gateway_fixture(PATIENT)


@pytest.fixture
def anna(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="anna") as client:
        client.reset()
        yield client
        client.reset()


# ---- the emergency stop


def test_no_stranger_undoes_an_emergency_stop_and_walks_the_robot(gateway: Gateway, anna: Client) -> None:
    with RclpyBridge(gateway, "--drive"), RclpyPeer() as stranger:
        stranger.call("/hexapod/estop")  # ROS's own is left at the robot, too
        anna.estop()
        left, why = stranger.call("/hexapod/reset")
        stranger.call("/hexapod/drive")
        stranger.advertise("/hexapod/cmd_vel", Twist)
        for _ in range(10):
            stranger.publish("/hexapod/cmd_vel", Twist(Vector3(0.05)))
        assert (left, why) == (False, f"rejected: estopped: {NO_RESET}")
        assert anna.state().mode == Mode.ESTOPPED
        assert not running(anna)


def test_a_reset_that_the_owner_allows_leaves_the_emergency_stop(gateway: Gateway, anna: Client) -> None:
    with RclpyBridge(gateway, "--allow-reset"), RclpyPeer() as peer:
        anna.estop()
        assert peer.call("/hexapod/reset")[0]
        assert anna.state().mode == Mode.IDLE
