"""A lost laptop is out: two laptops with certificates, each on its own link, a robot, and an observer on the robot."""

import datetime as dt
import json
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from schemas.robot import LEGS
from schemas.telemetry import Kind
from tests.net.hosts import LaptopHost, RobotHost, with_certificates
from tests.net.namespaces import Network
from tests.support.child import Child
from tests.support.gateway_process import COMMAND

pytestmark = pytest.mark.net

PORT = 7460
BACK_S = 3.0
"""Within which everybody else is back, as it was promised."""
AGAIN_S = 0.05
LATE_MS = 500.0
"""What a busy machine may add to an answer."""


KNOCKING = """
import sys, time, zenoh
from contextlib import suppress
from pathlib import Path
from gateway.zenoh_config import load_config
while True:
    config = load_config(Path(sys.argv[1]))
    config.insert_json5("connect/timeout_ms", "500")
    with suppress(zenoh.ZError):
        session = zenoh.open(config)
        session.put("hexapod/estop/cmd", b"")
        session.close()
    print("tried", flush=True)
    time.sleep(float(sys.argv[2]))
"""
"""Opens a session again and again, and presses the emergency stop in each."""


@dataclass
class Scene:
    """`folder` has the CA, and is on a third machine (the robot's own, here)."""

    robot: RobotHost
    anna: LaptopHost
    bert: LaptopHost
    folder: Path
    network: Network

    def revoke(self, name: str) -> Child:
        """`certs revoke` of that name, over bert's connection."""
        robot = ("--to", f"tls/{self.network.robot_address(1)}:{PORT}")
        bert = ("--zenoh-config", str(self.folder / "bert.json5"))
        command = [*COMMAND, "certs", "revoke", name, "--dir", str(self.folder), *robot, *bert]
        child = Child([*self.network.laptop(1), *command], os.environ)
        child.wait(30)
        child.close()
        return child

    def on_the_robot(self) -> Client:
        """The client that needs no certificate, once it has come back."""
        self.robot.client.wait_ready(20)
        return self.robot.client


@pytest.fixture
def scene(network: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    """With a folder of its own for what the robot keeps."""
    state = tmp_path / "state"
    state.mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(state))
    settings: dict[str, dict[str, Any]] = {"lease": {"ttl_ms": 2000.0}}
    with with_certificates(network, tmp_path, "anna", "bert", port=PORT, settings=settings) as (robot, laptops):
        yield Scene(robot, laptops[0], laptops[1], tmp_path / "D", network)


def walk(scene: Scene, laptop: LaptopHost) -> None:
    """All six legs, at 50 Hz, with the lease."""
    assert laptop.ask("lease acquire")["verified"] is True
    laptop.start(*LEGS)
    laptop.stream(*LEGS)
    scene.robot.wait_for_commands(*LEGS)


def logged(robot: RobotHost, kind: Kind) -> dt.datetime:
    """When the gateway has logged such an event for the last time."""
    lines = robot.gateway.child.stdout + robot.gateway.child.stderr
    found = [line for line in lines.splitlines() if f'"kind": "{kind}"' in line]
    return dt.datetime.fromisoformat(json.loads(found[-1])["timestamp"])


def test_revoked_in_mid_walk_and_everybody_else_is_back_within_three_seconds(scene: Scene) -> None:
    """Nor does she cost anybody a Stop afterwards, when her laptop presses the emergency stop every 50 ms."""
    robot, anna, bert = scene.robot, scene.anna, scene.bert
    walk(scene, anna)
    lost = shutil.copytree(scene.folder, scene.folder.with_name("lost"))
    child = scene.revoke("anna")
    assert child.returncode == 0, child.stderr
    bert.wait_for_answer()
    back = dt.datetime.now(dt.UTC)
    revoked, stopping, started = (logged(robot, kind) for kind in (Kind.REVOKED, Kind.STOPPING, Kind.STARTED))
    print(
        f"revoked: legs stopped after {(stopping - revoked).total_seconds() * 1000:.1f} ms, commands taken after "
        f"{(started - revoked).total_seconds():.2f} s, bert answered after {(back - revoked).total_seconds():.2f} s"
    )
    assert revoked <= stopping <= started
    assert (back - revoked).total_seconds() < BACK_S
    assert scene.on_the_robot().state().lease.holder is None
    assert not robot.running
    anna.child.tell("estop")  # over the session that she had, which tries for as long as bert drives
    with closing(knocking(scene, lost / "anna.json5")) as child:
        child.wait_for_line(10, 20)
        walk(scene, bert)
        bert.ask("sent 300")
        answers_ms = [bert.ask("state")["answered_ms"] for _ in range(50)]
        child.wait_for_line(40, 20)
        assert robot.running == {*LEGS}, "bert's stream was never silent"
        stopped = bert.ask("stop")
        print(f"state answered within {max(answers_ms):.1f} ms, stop within {stopped['answered_ms']:.1f} ms")
        assert stopped["accepted"]
        assert stopped["answered_ms"] < LATE_MS
        state = scene.on_the_robot().state()
        assert state.estop == 0, "none of her emergency stops arrived"
        assert state.watchdog.expirations == 0
    bert.ask("pause")
    robot.gateway.child.wait_for_output("rejected connections with revoked certificates: operator-00")


def knocking(scene: Scene, config: Path) -> Child:
    """A program that comes again and again with a copy of the files of somebody who is revoked."""
    command = [*scene.network.laptop(0), sys.executable, "-c", KNOCKING, str(config), str(AGAIN_S)]
    return Child(command, os.environ)
