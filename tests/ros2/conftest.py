"""A gateway, a bridge and a peer that all tests here share; each begins and ends with a bridge that does not drive."""

from collections.abc import Iterator
from contextlib import suppress

import pytest

from gateway.client import Client
from gateway.errors import RejectedError
from gateway.people.ros2.messages import DiagnosticArray, JointState, Twist
from tests.support.bridged import PATIENT
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.rclpy_peer import COMMANDS, DIAGNOSTICS, RclpyBridge, RclpyPeer
from tests.support.ros2_messages import Float64, Int32

gateway = gateway_fixture(PATIENT, scope="package")


@pytest.fixture(scope="package")
def bridge(gateway: Gateway) -> Iterator[RclpyBridge]:
    with RclpyBridge(gateway) as running_one:
        yield running_one


@pytest.fixture(scope="package")
def one_peer(bridge: RclpyBridge) -> Iterator[RclpyPeer]:
    del bridge
    with RclpyPeer() as running_one:
        running_one.subscribe(DIAGNOSTICS, DiagnosticArray)
        running_one.advertise(COMMANDS, JointState)
        running_one.advertise("/hexapod/cmd_vel", Twist)
        running_one.advertise("/hexapod/cmd_gait_type", Int32)
        for topic in ("roll_setpoint", "pitch_setpoint", "cmd_base_height"):
            running_one.advertise(f"/hexapod/{topic}", Float64)
        yield running_one


@pytest.fixture
def watcher(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="watcher") as client:
        with suppress(RejectedError):  # the bridge may hold the lease yet
            client.reset()
        yield client


@pytest.fixture
def peer(one_peer: RclpyPeer, watcher: Client) -> Iterator[RclpyPeer]:
    """Yield a peer of a bridge that does not drive, whatever the previous test left."""
    one_peer.call("/hexapod/release")
    yield one_peer
    one_peer.call("/hexapod/release")
    watcher.reset()


@pytest.fixture
def driven(peer: RclpyPeer) -> RclpyPeer:
    """Yield a peer of a bridge that drives."""
    assert peer.call("/hexapod/drive") == (True, "drives as ros2")
    return peer
