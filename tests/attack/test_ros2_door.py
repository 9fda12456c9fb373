"""What a stranger in ROS 2's graph does to the robot: whoever reaches that router has the rights of the bridge."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.client import Client
from gateway.people.ros2.messages import DiagnosticArray, DiagnosticStatus, Twist, Vector3
from gateway.zenoh_config import load_config
from schemas.telemetry import Kind, Mode
from tests.support.bridged import PATIENT, Bridge, Received, bridged
from tests.support.command import run_here
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import events, running, states
from tests.support.ros2_peer import Peer
from tests.support.router import zenoh_listening


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    with Gateway(tmp_path_factory.mktemp("gateway"), PATIENT) as running_one:
        yield running_one


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
    with bridged(gateway, "--drive") as bridge, Peer(bridge.endpoint) as stranger:
        anna.estop()
        stranger.call("/hexapod/estop")  # as if it were ROS's own
        left, why = stranger.call("/hexapod/reset")
        stranger.call("/hexapod/drive")
        publisher = bridge.publisher("cmd_vel", Twist)
        for _ in range(10):
            publisher.publish(Twist(Vector3(0.05)))
        assert not left, why
        assert anna.state().mode == Mode.ESTOPPED
        assert not running(anna)


def test_ros_leaves_its_own_emergency_stop_while_the_bridge_drives(gateway: Gateway, anna: Client) -> None:
    with bridged(gateway) as bridge, Peer(bridge.endpoint) as peer:
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


def test_a_reset_of_anybodys_wants_an_option(gateway: Gateway, anna: Client) -> None:
    with bridged(gateway, "--allow-reset") as bridge, Peer(bridge.endpoint) as peer:
        anna.estop()
        assert peer.call("/hexapod/reset")[0]
        assert anna.state().mode == Mode.IDLE


# ---- who reaches the router


def test_a_router_that_others_reach_is_rejected_in_words(gateway: Gateway) -> None:
    port = free_port()
    with zenoh_listening(f"tcp/0.0.0.0:{port}"):
        tried = run_here("ros2", "--router", f"tcp/127.0.0.1:{port}", "--connect", gateway.endpoint, timeout_s=20)
    assert tried.returncode == 2, tried
    assert f"open to the network without certificates (tcp/0.0.0.0:{port})" in tried.stderr
    assert "ZENOH_CONFIG_OVERRIDE" in tried.stderr


def test_an_open_graph_that_is_accepted_shows_in_diagnostics_state_and_events(gateway: Gateway, anna: Client) -> None:
    port = free_port()
    happened = events(anna)
    with zenoh_listening(f"tcp/0.0.0.0:{port}") as router:
        with Bridge(gateway, f"tcp/127.0.0.1:{port}", router, "--open-graph", "--drive") as bridge:
            own = Received(bridge, "diagnostics", DiagnosticArray).wait(lambda _: True).status[-1]
            assert own.level == DiagnosticStatus.WARN
            assert "all who reach it can drive the robot" in own.message
            assert anna.state().lease.holder == "ros2 (open graph)"
        happened.wait(lambda event: event.kind == Kind.LEASE_RELEASED and event.source == "ros2 (open graph)")


def test_what_the_router_says_of_itself_counts_too(gateway: Gateway) -> None:
    """A second endpoint, beside the one on loopback that the bridge dials."""
    dialled = f"tcp/127.0.0.1:{free_port()}"
    with zenoh_listening(dialled, "tcp/0.0.0.0:0", adminspace={"enabled": True}):
        tried = run_here("ros2", "--router", dialled, "--connect", gateway.endpoint, timeout_s=20)
    assert tried.returncode == 2, tried
    assert "open to the network without certificates" in tried.stderr


@pytest.mark.parametrize("mutual", [True, False])
def test_a_router_that_demands_certificates_is_not_open(gateway: Gateway, tmp_path: Path, mutual: bool) -> None:
    folder, port = tmp_path / "D", free_port()
    certs.folder.init(folder, ["127.0.0.1"], port=port)
    certs.folder.issue(folder, "ros", "operator")
    own = load_config(folder / "gateway.json5")
    tls = json.loads(own.get_json("transport/link/tls")) | {"enable_mtls": mutual}
    arguments = ("--router-config", str(folder / "ros.json5"))
    with zenoh_listening(f"tls/0.0.0.0:{port}", transport={"link": {"tls": tls}}) as router:
        if mutual:
            with Bridge(gateway, f"tls/127.0.0.1:{port}", router, *arguments) as bridge:
                own_status = Received(bridge, "diagnostics", DiagnosticArray).wait(lambda _: True).status[-1]
                assert own_status.level == DiagnosticStatus.OK
        else:
            tried = run_here("ros2", *arguments, "--connect", gateway.endpoint, timeout_s=20)
            assert tried.returncode == 2, tried
            assert f"(tls/127.0.0.1:{port}" in tried.stderr or f"(tls/0.0.0.0:{port}" in tried.stderr


def test_nobody_keeps_the_bridge_from_starting_by_the_token_of_a_gateway(gateway: Gateway) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with zenoh_listening(endpoint) as router:
        token = router.liveliness().declare_token("x/hexapod/alive")
        impostor = router.declare_queryable("x/hexapod/state", lambda query: query.reply(query.key_expr, b"{}"))
        with Bridge(gateway, endpoint, router):
            pass
        impostor.undeclare()
        token.undeclare()


def test_a_gateway_that_dials_the_ros_router_is_found(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        zenoh_listening(endpoint),
        Gateway(tmp_path, {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"], "connect": [endpoint]}}) as reachable,
    ):
        tried = run_here("ros2", "--router", endpoint, "--connect", reachable.endpoint, timeout_s=20)
    assert tried.returncode == 2, tried
    assert "where no ROS peer should be" in tried.stderr
