"""Incidents of real gateways are decided again once their processes have died: the same frames, in another process."""

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from gateway.client import Client
from gateway.errors import GatewayError
from gateway.model.power_board import SERVO_OVERCURRENT
from schemas.words import Mode
from tests.support.boards import Adapter
from tests.support.child import Child
from tests.support.fixtures import patient
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.waiting import wait_until
from tests.zenoh.test_plugin import Installed
from tests.zenoh.test_revoked import Robot

pytestmark = pytest.mark.full

LATE_S = 15.0
TURNS = 40


def drive(client: Client, turns: int = TURNS, legs: tuple[int, ...] = (1, 2)) -> None:
    """Move these legs as fast as their answers come: at the rate limit."""
    for leg in legs:
        client.start_leg(leg, 90, 90, 90)
    for turn in range(turns):
        for leg in legs:
            client.set_leg(leg, 60 + turn, 90, 90)


class Scene(NamedTuple):
    """A running gateway, and what belongs to it."""

    gateway: Gateway
    client: Client
    plugin: Installed
    adapter: Adapter | None = None

    def wait(self, mode: Mode) -> None:
        wait_until(lambda: self.client.state().mode == mode)


def estop(scene: Scene) -> None:
    assert scene.client.estop().accepted
    assert scene.client.start_leg(1, 9, 9, 9, check=False).reason == "estopped"


def silence(scene: Scene) -> None:
    scene.wait(Mode.IDLE)


def take_over(scene: Scene) -> None:
    with scene.gateway.client(source="ben") as ben, scene.client.lease(), suppress(GatewayError):
        drive(scene.client, 5)
        with ben.lease(take=True):
            drive(ben, 5)


def bus_fault(scene: Scene) -> None:
    scene.plugin.fails.touch()
    scene.client.set_leg(1, 90, 90, 90, check=False)
    scene.wait(Mode.BUS_FAULT)
    scene.plugin.fails.unlink()
    scene.wait(Mode.IDLE)
    drive(scene.client, 5)


def board_fault(scene: Scene) -> None:
    assert scene.adapter is not None
    scene.adapter.board.fail(SERVO_OVERCURRENT, 0b111)
    scene.wait(Mode.IDLE)


def frozen(scene: Scene) -> None:
    scene.gateway.child.send_signal(signal.SIGSTOP)
    begun_s = time.monotonic()
    wait_until(lambda: time.monotonic() > begun_s + 1)  # the silence itself
    scene.gateway.child.send_signal(signal.SIGCONT)
    scene.wait(Mode.IDLE)


LANDS = {"watchdog": {"landing_ms": 600, "timeout_ms": 700}}
SHORT = {"watchdog": {"timeout_ms": 700}}
PLUGGED: Mapping[str, Any] = {"wire": {}}
POWERED: Mapping[str, Any] = {**PLUGGED, "power": {}}
SCENES: dict[str, tuple[str, Mapping[str, Any], Callable[[Scene], object]]] = {
    "an emergency stop": ("estop", {}, estop),
    "a silent leg": ("watchdog", SHORT, silence),
    "a landing": ("landing", LANDS, silence),
    "a taken lease": ("lease-taken", {}, take_over),
    "a kill": ("crash", {}, lambda _: None),
    "a plug-in": ("watchdog", {**PLUGGED, **SHORT}, silence),
    "a bus fault": ("bus-fault", PLUGGED, bus_fault),
    "a board's fault": ("power-fault", POWERED, board_fault),
    "a frozen gateway": ("watchdog", SHORT, frozen),
}


def replayed(state: Path, what: str) -> None:
    """Play the last incident of a dead gateway without its settings, and run the test that it makes."""
    config, test = state.parent / "laptop.toml", state.parent / "test_incident.py"
    config.write_text(f'state.path = "{state}"\n')
    command = [*COMMAND, "incidents", "replay", "last", "--as-test", str(test), "--config", str(config)]
    with Child(command, {**os.environ, "PYTHONHASHSEED": "1"}) as child:
        child.wait(60)
    assert child.returncode == 0, str(child)
    assert child.stdout.split(":")[0].endswith(f"-{what}")
    assert "the same" in child.stdout.splitlines()[-1]
    with Child([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(test)], os.environ) as ran:
        ran.wait(60)
    assert (ran.returncode, "1 passed" in ran.stdout) == (0, True), str(ran)


@pytest.mark.parametrize("name", SCENES)
def test_an_incident_of_a_dead_gateway_has_the_same_frames(tmp_path: Path, name: str) -> None:
    what, sections, happens = SCENES[name]
    plugin = Installed(tmp_path)
    options = () if "wire" in sections else ("--sim",)
    adapter = Adapter(str(tmp_path / "board")) if "power" in sections else None
    settings = {**patient(), **sections, "state": {"path": str(tmp_path / "state")}}
    if adapter is not None:
        settings["power"] = {"interface": "slcan", "channel": str(tmp_path / "board")}
    if "wire" in sections:
        settings["wire"] = {"name": "to-file", "path": str(plugin.path)}
    with (
        Gateway(tmp_path, settings, options=options, env=plugin.env) as gateway,
        gateway.client(source="anna") as client,
    ):
        drive(client)
        happens(Scene(gateway, client, plugin, adapter))
        gateway.child.kill()
        gateway.child.wait(LATE_S)
    if adapter is not None:
        adapter.unplug()
    replayed(tmp_path / "state", what)


def test_an_incident_before_a_revocation_restarts_the_gateway_plays_to_its_end(tmp_path: Path) -> None:
    robot = Robot(tmp_path)
    with robot.start() as gateway, robot.laptop("bert") as bert:
        drive(bert)
        number = bert.estop().estop
        assert robot.revoke("anna").returncode == 0
        wait_until(lambda: bert.state().estop == number)
        gateway.child.kill()
        gateway.child.wait(LATE_S)
    replayed(robot.state, "estop")
