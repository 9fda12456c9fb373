"""`hexapod-gateway button`: in a real terminal, on a real gateway."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.people.client.dangers import UNCONFIRMED
from schemas import keys
from schemas.telemetry import GatewayState, Kind, Mode
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import states
from tests.support.published import event
from tests.support.tmux import Terminal, at_terminal

pytestmark = [pytest.mark.full, pytest.mark.attended]

READY = "ANY KEY STOPS THE ROBOT"
SETTINGS = patient(10_000, buttons={"required": 1, "timeout_ms": 2000})


@pytest.fixture
def gateway(tmp_path: Path) -> Iterator[Gateway]:
    with Gateway(tmp_path, {**SETTINGS, "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}}) as running:
        yield running


@pytest.fixture
def watcher(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="watcher") as client:
        yield client


def button(folder: Path, gateway: Gateway, columns: int = 80) -> Terminal:
    folder.mkdir(exist_ok=True)
    return at_terminal(folder, "button --name kitchen", gateway.endpoint, columns=columns)


def alive(watcher: Client, *wanted: str) -> GatewayState:
    return states(watcher).wait(lambda state: state.buttons.names == wanted, timeout_s=30)


def test_any_key_stops_and_ctrl_c_leaves(tmp_path: Path, gateway: Gateway, watcher: Client) -> None:
    with button(tmp_path / "t", gateway) as terminal:
        terminal.wait(READY, "kitchen · 1 alive, 1 required")
        alive(watcher, "kitchen")
        assert watcher.start_leg(3, 90, 90, 90).accepted
        terminal.press("j")
        terminal.wait("STOPPED: 6 Stop frames written")
        state = states(watcher).wait(lambda each: each.mode == Mode.ESTOPPED)
        assert state.estop_source == "kitchen"
        assert watcher.reset().accepted
        terminal.wait(READY)
        terminal.press("C-c")
        assert terminal.wait_for_end() == 0
    alive(watcher)


@pytest.mark.parametrize(("program", "ready"), [("button --name kitchen", READY), ("walk", "forward, backward")])
def test_a_stop_that_the_power_board_does_not_confirm_is_red(tmp_path: Path, program: str, ready: str) -> None:
    """States come at changes only, and this robot has no board, so the event's alarm stays."""
    listen = {"listen": [f"tcp/127.0.0.1:{free_port()}"]}
    with (
        Gateway(tmp_path, {"zenoh": listen, "telemetry": {"state_hz": 0}}) as gateway,
        gateway.client(source="watcher") as watcher,
        at_terminal(tmp_path, program, gateway.endpoint) as terminal,
    ):
        terminal.wait(ready)
        watcher.session.put(keys.EVENT, event(Kind.POWER_UNCONFIRMED).model_dump_json())
        terminal.wait(UNCONFIRMED)
        terminal.press("C-c")
        assert terminal.wait_for_end() == 0


def test_one_that_freezes_is_silent_and_comes_back(tmp_path: Path, gateway: Gateway, watcher: Client) -> None:
    with button(tmp_path / "t", gateway) as terminal:
        terminal.wait(READY)
        alive(watcher, "kitchen")
        assert watcher.start_leg(3, 90, 90, 90).accepted
        pid = terminal.pid
        os.kill(pid, signal.SIGSTOP)
        try:
            assert alive(watcher).mode == Mode.IDLE
        finally:
            os.kill(pid, signal.SIGCONT)
        assert alive(watcher, "kitchen").mode == Mode.IDLE
        terminal.wait(READY)


def test_a_gateway_that_is_gone_is_said_loudly_and_one_that_is_back_is_registered_with(
    tmp_path: Path, gateway: Gateway
) -> None:
    with button(tmp_path / "t", gateway) as terminal:
        terminal.wait(READY)
        gateway.child.close()
        terminal.wait("THE GATEWAY DOES NOT RECEIVE THIS BUTTON")
        settings = {**SETTINGS, "zenoh": {"listen": [gateway.endpoint]}}
        with Gateway(tmp_path, settings) as second, second.client() as watcher:
            terminal.wait(READY)
            alive(watcher, "kitchen")
        terminal.press("j")
        terminal.wait("NOT STOPPED, NO ANSWER for")
        terminal.press("C-c")
        terminal.wait_for_end()
        terminal.wait("The emergency stop was NOT confirmed: switch the servos' power off.")


def test_two_of_one_name_do_not_take_it_from_each_other_for_ever_and_a_key_of_either_stops(
    tmp_path: Path, gateway: Gateway, watcher: Client
) -> None:
    with button(tmp_path / "first", gateway, columns=40) as first:
        first.wait(READY)
        alive(watcher, "kitchen")
        assert watcher.start_leg(3, 90, 90, 90).accepted
        with button(tmp_path / "second", gateway) as second:
            second.wait(READY)
            first.wait("ITS SILENCE STOPS NOTHING", "another button has registered as kitchen, or taken its place")
            assert watcher.state().mode == Mode.ACTIVE
            first.press("j")
            first.wait("STOPPED: 6 Stop frames written")
            assert watcher.state().mode == Mode.ESTOPPED
            first.press("C-c")
            assert first.wait_for_end() == 1
            alive(watcher, "kitchen")
