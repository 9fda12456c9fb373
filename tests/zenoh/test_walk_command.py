"""`hexapod-gateway walk`: without a person, and in a real terminal."""

from pathlib import Path

import pytest

from gateway.client import Client
from schemas.telemetry import Mode
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.tmux import at_terminal

pytestmark = [pytest.mark.full, pytest.mark.attended]

gateway = gateway_fixture(patient(10_000, telemetry={"frames": True}))
watcher = client_fixture("watcher")


def test_a_person_walks_stops_and_leaves(tmp_path: Path, gateway: Gateway, watcher: Client) -> None:
    with at_terminal(tmp_path, "walk", gateway.endpoint) as terminal:
        terminal.wait("Nothing moves before you press a key.", "drives", "It lies")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("t")
        terminal.wait("It stands")
        terminal.press("2")
        terminal.press("w")
        terminal.wait("It walks ripple")
        terminal.wait("It stands")  # a key that is released
        terminal.press("Space")
        terminal.wait("STOPPED: 6 Stop frames written within")
        assert watcher.state().mode == Mode.ESTOPPED
        terminal.press("w")
        terminal.wait("g goes on", "nothing runs until a reset")
        terminal.press("g")
        terminal.wait("It goes on with the next key.", "It lies")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("c")
        terminal.wait("It sits")
        terminal.press("q")
        assert terminal.wait_for_end(60) == 0
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None
