"""What a stranger in ROS 2's graph does to the robot: whoever reaches it has the rights of the bridge."""

from collections.abc import Iterator

import pytest

from gateway.client import Client
from gateway.people.ros2.messages import Twist, Vector3
from schemas.telemetry import Mode
from tests.support.bridged import PATIENT
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import running, states
from tests.support.rclpy_peer import RclpyBridge, RclpyPeer, needs_rclpy

pytestmark = [needs_rclpy, pytest.mark.full]

gateway = gateway_fixture(PATIENT)


@pytest.fixture
def anna(gateway: Gateway) -> Iterator[Client]:
    """A person, at the gateway itself."""
    with gateway.client(source="anna") as client:
        client.reset()
        yield client
        client.reset()


def nobody_drives(anna: Client) -> None:
    """Any more: the bridge has noticed the emergency stop."""
    states(anna).wait(lambda state: state.lease.holder is None)


# ---- the emergency stop of a person


def test_no_stranger_undoes_a_persons_emergency_stop_and_walks_the_robot(gateway: Gateway, anna: Client) -> None:
    with RclpyBridge(gateway, "--drive"), RclpyPeer() as stranger:
        anna.estop()
        stranger.call("/hexapod/estop")  # as if it were ROS's own
        left, why = stranger.call("/hexapod/reset")
        stranger.call("/hexapod/drive")
        stranger.advertise("/hexapod/cmd_vel", Twist)
        for _ in range(10):
            stranger.publish("/hexapod/cmd_vel", Twist(Vector3(0.05)))
        assert not left, why
        assert anna.state().mode == Mode.ESTOPPED
        assert not running(anna)


def test_ros_leaves_its_own_emergency_stop_while_the_bridge_drives(gateway: Gateway, anna: Client) -> None:
    with RclpyBridge(gateway), RclpyPeer() as peer:
        assert peer.call("/hexapod/estop")[0]
        assert "not while the bridge drove" in peer.call("/hexapod/reset")[1]
        assert anna.reset().accepted
        for _ in range(2):
            assert peer.call("/hexapod/drive")[0]
            assert peer.call("/hexapod/estop")[0]
            assert peer.call("/hexapod/estop")[0]
            nobody_drives(anna)
            assert peer.call("/hexapod/reset")[0]
            assert anna.state().mode == Mode.IDLE
        assert peer.call("/hexapod/drive")[0]
        assert peer.call("/hexapod/estop")[0]
        anna.estop()
        nobody_drives(anna)
        assert not peer.call("/hexapod/reset")[0]
        assert anna.reset().accepted
        assert peer.call("/hexapod/drive")[0]
        assert peer.call("/hexapod/estop")[0]
        peer.call("/hexapod/release")
        assert not peer.call("/hexapod/reset")[0]
