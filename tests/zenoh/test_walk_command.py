"""`hexapod-gateway walk`: without a person, and in a real terminal."""

from collections.abc import Callable
from pathlib import Path

from gateway.client import Client
from schemas.telemetry import GatewayState, Mode
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import states
from tests.support.tmux import Terminal, need_tmux

gateway = gateway_fixture({"watchdog": {"timeout_ms": 10_000}, "lease": {"ttl_ms": 10_000}})
watcher = client_fixture("watcher")


def once(watcher: Client, holds: Callable[[GatewayState], bool]) -> None:
    states(watcher).wait(holds, timeout_s=60)


def test_a_script_walks_sits_and_stops(gateway: Gateway, watcher: Client) -> None:
    end = gateway.run(
        "walk", "--forward", "0.1", "--seconds", "2", "--gait", "tripod", "--height", "0.14", timeout_s=90
    )
    assert end.returncode == 0, end.stderr
    ahead_m = float(end.stdout.removeprefix("walked ").partition(" m ahead")[0])
    assert 0.08 < ahead_m < 0.25
    assert end.stdout.endswith("m to the left, turned by 0°; it sits, and its servos are stopped\n")
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None


def test_what_it_cannot_do_ends_it_with_a_sentence(gateway: Gateway, watcher: Client) -> None:
    for arguments, sentence, code in (
        (("--seconds", "1", "--height", "0.6"), "it cannot stand 0.6 m high: leg 1 does not reach", 2),
        (("--seconds", "1", "--gait", "gallop"), "there is no gait 'gallop'; there are tripod, ripple, wave", 2),
        (("--seconds", "1", "--forward", "99"), "forward_m_s is 99; no walking robot does more than 10", 2),
        (("--seconds", "1", "--geometry", "/nowhere.json"), "/nowhere.json: cannot be read", 2),
        (("--forward", "0.1"), "go with --seconds; without it you drive from the keyboard", 2),
        ((), "walk from the keyboard needs a terminal", 1),
    ):
        end = gateway.run("walk", *arguments)
        assert (end.returncode, sentence in end.stderr) == (code, True), end.stderr
    assert watcher.state().mode == Mode.IDLE
    with watcher.lease():
        end = gateway.run("walk", "--seconds", "1")
        assert end.returncode == 1
        assert "held by watcher" in end.stdout


def test_a_person_walks_stops_and_leaves(tmp_path: Path, gateway: Gateway, watcher: Client) -> None:
    need_tmux()
    command = [*COMMAND, "walk", "--connect", gateway.endpoint]
    with Terminal(tmp_path, command) as terminal:
        terminal.wait("Nothing moves before you press a key.", "drives", "lying")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("t")
        terminal.wait("standing")
        terminal.press("2")
        terminal.press("w")
        terminal.wait("walking ripple")
        terminal.wait("standing")  # a key that is released
        terminal.press("c")
        terminal.wait("sitting")
        terminal.press("Space")
        terminal.wait("EMERGENCY STOP: 6 Stop frames written within")
        assert watcher.state().mode == Mode.ESTOPPED
        terminal.press("w")
        terminal.wait("emergency stop", "g goes on")
        terminal.press("g")
        terminal.wait("It goes on with the next key.")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("t")
        terminal.wait("standing")
        terminal.press("q")
        assert terminal.wait_for_end(60) == 0
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None


def test_ctrl_c_stops_it_at_once(tmp_path: Path, gateway: Gateway, watcher: Client) -> None:
    need_tmux()
    with Terminal(tmp_path, [*COMMAND, "walk", "--connect", gateway.endpoint]) as terminal:
        terminal.wait("Nothing moves before you press a key.")
        terminal.press("t")
        once(watcher, lambda state: state.mode == Mode.ACTIVE)
        terminal.press("C-c")
        once(watcher, lambda state: state.mode == Mode.IDLE)
        assert terminal.wait_for_end(60) == 0
