"""The service as a process on the simulated controller: settings that only a process shows, start and end, mistakes."""

import os
import re
import socket
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from schemas import keys
from tests.support.child import Child, frozen
from tests.support.gateway_process import READY, Gateway, free_port, write_settings


def test_it_says_that_it_is_ready_where_and_what_to_try_and_its_token_that_it_lives(tmp_path: Path) -> None:
    seen: dict[str, threading.Event] = {"SampleKind.PUT": threading.Event(), "SampleKind.DELETE": threading.Event()}
    with Gateway(tmp_path) as gateway, gateway.client() as client:
        gateway.child.wait_for_output("Try")
        assert gateway.child.stdout.splitlines() == [
            f"{READY}: {gateway.endpoint} → a simulated controller (plain)",
            f"Try, in a second terminal: hexapod-gateway walk --forward 0.1 --seconds 5 --connect {gateway.endpoint}",
        ]
        subscriber = client.session.liveliness().declare_subscriber(
            keys.ALIVE, lambda sample: seen[str(sample.kind)].set(), history=True
        )
        assert seen["SampleKind.PUT"].wait(10)
        gateway.child.kill()
        assert seen["SampleKind.DELETE"].wait(10)
        del subscriber


def test_a_frozen_peer_does_not_hold_the_end(tmp_path: Path) -> None:
    publisher = (
        "import sys, time\n"
        "from gateway.zenoh_config import client_config, open_session\n"
        "config = client_config(sys.argv[1])\n"
        "config.insert_json5('transport/link/tx/lease', '600000')\n"  # so Zenoh does not give it up before the end
        "session = open_session(config)\n"
        "heard = session.declare_subscriber('hexapod/frame', lambda frame: None)\n"
        "list(session.get('hexapod/state'))\n"
        "print('listening', flush=True)\n"
        "time.sleep(600)\n"
    )
    settings: dict[str, dict[str, Any]] = {"telemetry": {"frames": True}, "limits": {"leg_rate_hz": 1000}}
    with (
        Gateway(tmp_path, settings) as gateway,
        Child([sys.executable, "-c", publisher, gateway.endpoint], os.environ) as peer,
    ):
        peer.wait_for_output("listening")
        with frozen(peer.pid):
            with gateway.client() as client:
                # Until the frozen one's queues are full: then closing takes Zenoh ten seconds.
                client.start_leg(1, 90, 45, 120)
                written = 0
                while written < 2000:
                    ack = client.set_leg(1, 90, 45, 120, check=False)
                    written += ack.accepted and not ack.coalesced
                    if not ack.accepted:  # the watchdog, on a busy machine
                        client.start_leg(1, 90, 45, 120, check=False)
            gateway.child.terminate()
            assert gateway.child.wait() == 0
        assert "ending without waiting for it" in gateway.child.stderr


def test_a_port_that_is_taken_ends_it_with_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        listens = f"tcp/{address} is taken by another program (perhaps another gateway); stop it, or set another"
        metrics = f"telemetry.metrics: {address} cannot be opened: Address already in use"
        for section, code, line in (
            ({"zenoh": {"listen": [f"tcp/{address}"]}}, 4, f"{listens} zenoh.listen"),
            ({"telemetry": {"metrics": address}}, 2, metrics),
        ):
            with Gateway(tmp_path, section, wait=False) as gateway:
                assert gateway.child.wait() == code
                assert gateway.child.stderr == f"hexapod-gateway: {line}\n"


BROKEN = """
from gateway.robot.runtime import conductor
def broken(self, received, now_ns):
    raise RuntimeError("planted")
conductor.Conductor._receive = broken
"""
DEAF = """
from gateway.robot.zenoh_io import inbox
inbox.Inbox.receives = property(lambda self: False)
"""
RUN = """
import atexit, os, sys
from gateway import cli
atexit.register(os.write, 2, b"ended by the interpreter, which aborts while a thread is inside Zenoh")
sys.argv[1:] = ["run", "--sim", "--config", sys.argv[1]]
cli.main()
"""


@pytest.mark.parametrize(
    ("planted", "last"),
    [
        (BROKEN, "hexapod-gateway: a mistake in the gateway ended it: planted"),
        (DEAF, "a thread that waits for commands has ended"),
    ],
)
def test_a_mistake_of_ours_stops_the_robot_and_ends_the_service(tmp_path: Path, planted: str, last: str) -> None:
    """Planted in the process's own code: nobody knows what state is left, so the robot must stand."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"listen": [endpoint]}})
    with Child([sys.executable, "-X", "dev", "-c", planted + RUN, str(config)], os.environ) as child:
        if planted is BROKEN:
            child.wait_for_output(READY, 60)
            with Client(endpoint, timeout_s=20) as client:
                client.publish(keys.leg_command(3), {})
                child.wait()
        assert child.wait() == 1
    assert last in child.stderr.splitlines()[-1]
    assert len(re.findall(r"servo \d\d stopped", child.stderr)) >= 2 * 18, "at the start, and at this end"
