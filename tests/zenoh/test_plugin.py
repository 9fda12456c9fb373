"""A plug-in's wire (`gateway.wire`), installed as somebody else's package: what it is called with, and when."""

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

import pytest

from gateway.errors import GatewayError
from schemas.keys import servo_command
from schemas.robot import SERVO_IDS
from schemas.words import Mode
from tests.support.child import Child
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway
from tests.support.heard import states

NAME: Final = "to-file"
WIRE: Final = """
import json
import os
import time

from gateway.wire import ServoWire


class ToFile(ServoWire):
    def __init__(self, options):
        if "path" not in options:
            raise ValueError("path is missing: the file to write to")
        self._path = options["path"]

    def open(self):
        self._file = open(self._path, "a")

    def apply(self, changes):
        if os.path.exists(self._path + ".mistake"):
            raise RuntimeError("a mistake in the plug-in")
        if os.path.exists(self._path + ".fails"):
            raise OSError("it does not answer")
        while os.path.exists(self._path + ".hangs"):
            open(self._path + ".hung", "w").close()
            time.sleep(0.01)
        self._file.write(json.dumps([os.getpid(), list(changes)]) + "\\n")
        self._file.flush()

    def close(self):
        self._file.close()
"""


class Call(NamedTuple):
    """One call of `apply`."""

    process: int
    changes: dict[int, float | None]

    @property
    def stops(self) -> bool:
        return set(self.changes.values()) == {None}


class Installed:
    """The plug-in, installed in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "written"
        self.settings = patient(wire={"name": NAME, "path": str(self.path)})
        self.env = {**os.environ, "PYTHONPATH": str(folder), "RUNTIME_DIRECTORY": str(folder)}
        """The environment of a program that finds the plug-in."""
        names = ("mistake", "fails", "hangs", "hung")
        self.mistake, self.fails, self.hangs, self.hung = (folder / f"written.{name}" for name in names)
        (folder / "to_file.py").write_text(WIRE)
        described = folder / "to_file-1.0.dist-info"  # as if pip had installed it
        described.mkdir()
        (described / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {NAME}\nVersion: 1.0\n")
        (described / "entry_points.txt").write_text(f"[hexapod_gateway.wires]\n{NAME} = to_file:ToFile\n")

    def calls(self, since: int = 0) -> list[Call]:
        """Return its calls, from the first or that one on."""
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        return [Call(process, dict(changes)) for process, changes in map(json.loads, lines[since:])]


LEG_3 = {31: 90.0, 32: 45.0, 33: 120.0}


@pytest.fixture
def plugin(tmp_path: Path) -> Installed:
    return Installed(tmp_path)


@pytest.fixture
def gateway(plugin: Installed, tmp_path: Path) -> Iterator[Gateway]:
    with Gateway(tmp_path, plugin.settings, options=(), env=plugin.env) as running:
        yield running


def stop_servos(gateway: Gateway, plugin: Installed) -> Child:
    """Run the command in a process of its own, to its end."""
    command = [sys.executable, "-m", "gateway", "stop-servos", "--config", str(gateway.config)]
    with Child(command, plugin.env) as child:
        child.wait()
    return child


def test_a_plugin_starts_moves_and_stops_servos_with_stops_first_and_alone(plugin: Installed, gateway: Gateway) -> None:
    assert [set(each.changes) for each in plugin.calls()[:1]] == [{*SERVO_IDS}], "Stops before any command can arrive"
    with gateway.client() as client:
        state = client.state()
        assert (state.wire.name, state.spi.device, state.spi.framing, state.protocol) == (NAME, NAME, "none", NAME)
        since = len(plugin.calls())
        client.start_leg(3, *LEG_3.values())
        client.ask(servo_command(32), {"op": "set", "angle_deg": 46})
        moved = [each.changes for each in plugin.calls(since) if not each.stops]
        assert moved == [LEG_3, {32: 46.0}]
        since = len(plugin.calls())
        heard = states(client)
        assert client.estop().accepted
        heard.wait(lambda state: state.mode == Mode.ESTOPPED)
        stopped = [each for each in plugin.calls(since) if each.changes.keys() & LEG_3]
        assert stopped[0].changes.keys() == {*SERVO_IDS}, "not only those that ran"
        assert all(each.stops for each in stopped)
        assert client.reset().accepted


def test_stop_servos_goes_through_it_in_a_process_of_its_own(plugin: Installed, gateway: Gateway) -> None:
    with gateway.client() as client:
        client.start_leg(3, *LEG_3.values())
        ended = stop_servos(gateway, plugin)
        assert ended.returncode == 0, str(ended)
        assert f"Stop written to all six legs, 4 times each, on {NAME}" in ended.stdout
        assert "The running gateway counts all servos as stopped" in ended.stdout
        theirs = [each for each in plugin.calls() if each.process == ended.pid]
        assert [set(each.changes) for each in theirs] == [{*SERVO_IDS}] * 4
        assert not any(servo.running for leg in client.state().legs for servo in leg.servos)
    gateway.child.kill()
    assert stop_servos(gateway, plugin).returncode == 0, "without a gateway, too"


def test_a_mistake_in_it_ends_the_gateway_with_stops_tried(plugin: Installed, gateway: Gateway) -> None:
    with gateway.client() as client:
        client.start_leg(3, *LEG_3.values())
        plugin.mistake.touch()
        with suppress(GatewayError):  # it may end before it answers
            client.ask(servo_command(32), {"op": "set", "angle_deg": 46})
        assert gateway.child.wait() == 1
    assert "a mistake in the plug-in" in gateway.child.stderr
    assert "no Stop could be written to legs 1, 2, 3, 4, 5, 6" in gateway.child.stderr


def test_a_call_that_hangs_ends_the_gateway_as_a_hanging_driver_does(plugin: Installed, tmp_path: Path) -> None:
    env = {**plugin.env, "NOTIFY_SOCKET": "/nowhere", "WATCHDOG_USEC": "1000000"}
    with Gateway(tmp_path, plugin.settings, options=(), env=env) as gateway:
        plugin.hangs.touch()  # one of the Stops that follow the start
        assert gateway.child.wait() == -signal.SIGALRM
        assert plugin.hung.exists()
        plugin.hangs.unlink()
        assert stop_servos(gateway, plugin).returncode == 0
