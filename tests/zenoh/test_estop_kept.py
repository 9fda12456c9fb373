"""An emergency stop outlasts the gateway, however that ends, and whatever the disk does; all with real processes."""

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway import durable
from gateway.client import Client
from gateway.robot.host.calibration_file import SLOW_S
from gateway.robot.host.estop_file import ESTOP_FILE, LAST_FILE
from schemas import keys
from schemas.telemetry import Kind, Mode, Reason
from tests.support.closing import Closing
from tests.support.gateway_process import Gateway
from tests.support.heard import events

LATE_S = 15.0


@pytest.fixture
def gateway(tmp_path: Path) -> Iterator["Gateways"]:
    with Gateways(tmp_path) as made:
        yield made


class Gateways(Closing):
    """One after the other, on the same state directory."""

    def __init__(self, folder: Path) -> None:
        self._folder, self.state = folder, folder / "state"
        self.state.mkdir()
        self._running: list[Gateway] = []

    def start(self) -> Gateway:
        self.close()
        self._running = [Gateway(self._folder, env={"HEXAPOD_STATE__PATH": str(self.state)})]
        return self._running[0]

    def close(self) -> None:
        for each in self._running:
            each.close()


def until(condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + LATE_S
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.001)


def press(client: Client, source: str = "anna") -> int:
    """Engage it; its number."""
    ack = client.ask(keys.ESTOP, {"source": source})
    assert ack.stop_frames == 6
    assert ack.estop is not None
    return ack.estop


def is_kept(folder: Path, number: int) -> bool:
    path = folder / ESTOP_FILE
    text = path.read_text() if path.exists() else ""  # it is there before its text is
    return bool(text) and json.loads(text)["number"] == number


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_it_is_engaged_again_however_the_gateway_ended_and_a_reset_ends_it_for_good(
    gateway: Gateways, how: signal.Signals
) -> None:
    first = gateway.start()
    with first.client() as client:
        assert press(client, "anna") == 1
        since = client.state().estop_since
    if how is signal.SIGKILL:  # an end in order waits for the write
        until(lambda: is_kept(gateway.state, 1))
    first.child.send_signal(how)
    first.child.wait(LATE_S)
    assert is_kept(gateway.state, 1)
    second = gateway.start()
    with second.client() as client:
        found = client.state()
        assert (found.mode, found.estop) == (Mode.ESTOPPED, 1)
        assert (found.estop_source, found.estop_since, found.estop_fault) == ("anna", since, None)
        assert client.start_leg(3, 90, 90, 90, check=False).reason is Reason.ESTOPPED
        second.child.wait_for_output("is still engaged")
        assert client.ask(keys.RESET, {"estop": 1}).accepted
        until(lambda: not (gateway.state / ESTOP_FILE).exists())
    second.child.kill()
    with gateway.start().client() as client:
        found = client.state()
        assert (found.mode, found.estop, found.estop_since) == (Mode.IDLE, 1, None)
        assert press(client) == 2
        assert client.ask(keys.RESET, {"estop": 1}).reason is Reason.ESTOPPED, "it was sent to an earlier run"


# ---- the disk (all ways to be damaged: tests/unit/robot/test_estop_file.py)


def test_where_the_disk_hangs_it_starts_estopped_says_so_and_a_person_may_reset_it(gateway: Gateways) -> None:
    os.mkfifo(durable.staged_for(gateway.state / LAST_FILE))
    first = gateway.start()
    with first.client() as client:
        found = client.state()
        assert found.mode is Mode.ESTOPPED
        assert "has not answered for 2 s" in str(found.estop_fault)
        assert found.spi.frames >= 6, "no Stop waits for it"
        first.child.wait_for_output("since it is not known what an earlier run has left")
        assert client.start_leg(3, 90, 90, 90, check=False).reason is Reason.ESTOPPED
        assert client.ask(keys.RESET, {"estop": found.estop}).accepted
        assert client.start_leg(3, 90, 90, 90).accepted


def test_no_stop_waits_for_a_disk_that_hangs_while_it_runs(gateway: Gateways) -> None:
    first = gateway.start()
    os.mkfifo(durable.staged_for(gateway.state / ESTOP_FILE))
    with first.client() as client:
        heard = events(client)
        for number in (1, 2, 3):
            assert press(client) == number
        assert client.state().mode is Mode.ESTOPPED
        event = heard.wait(lambda each: each.kind == Kind.ESTOP_NOT_KEPT, timeout_s=SLOW_S + LATE_S)
        assert "has not answered for 5 s" in event.detail
        assert client.ask(keys.RESET, {"estop": 3}).accepted
    first.child.send_signal(signal.SIGTERM)
    assert first.child.wait(LATE_S) == 0, "the disk hangs on"
