"""A gateway, a bridge and a peer that all tests here share; each begins and ends with a bridge that does not drive."""

from collections.abc import Iterator

import pytest

from gateway.client import Client
from tests.support.bridged import PATIENT, Bridge, bridged
from tests.support.gateway_process import Gateway
from tests.support.ros2_peer import Peer


@pytest.fixture(scope="package")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    with Gateway(tmp_path_factory.mktemp("gateway"), PATIENT) as running:
        yield running


@pytest.fixture(scope="package")
def shared(gateway: Gateway) -> Iterator[Bridge]:
    with bridged(gateway, "--tf") as running:
        yield running


@pytest.fixture(scope="package")
def shared_peer(shared: Bridge) -> Iterator[Peer]:
    with Peer(shared.endpoint) as running:
        yield running


@pytest.fixture
def watcher(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="watcher") as client:
        client.reset()
        yield client


@pytest.fixture
def bridge(shared: Bridge, shared_peer: Peer, watcher: Client) -> Iterator[Bridge]:
    """Not driving, whatever the test before it has left."""
    shared_peer.call("/hexapod/release")
    yield shared
    watcher.reset()
    shared_peer.call("/hexapod/release")


@pytest.fixture
def peer(bridge: Bridge, shared_peer: Peer) -> Peer:
    """One that is not ours."""
    del bridge
    return shared_peer


@pytest.fixture
def driven(peer: Peer, bridge: Bridge) -> Bridge:
    """A bridge that drives."""
    assert peer.call("/hexapod/drive") == (True, "drives as ros2")
    return bridge
