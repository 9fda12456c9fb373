"""`hexapod-gateway walk`: without a person, and in a real terminal."""

import signal
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.geometry import load
from gateway.model.frames import Op, decode
from gateway.people.walking import STILL, Engine, Robot
from schemas.robot import JOINTS, LEGS
from schemas.telemetry import Cause, FrameRecord, Mode
from tests.support.child import Child
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import frames
from tests.support.tmux import at_terminal

pytestmark = [pytest.mark.full, pytest.mark.attended]

gateway = gateway_fixture(patient(10_000, telemetry={"frames": True}))
watcher = client_fixture("watcher")


def stopped_at(records: list[FrameRecord]) -> dict[int, float]:
    """Where the servos were sent last before their Stops, in degrees."""
    found: dict[int, float] = {}
    for record in records:
        for servo_id, op in decode(bytes.fromhex(record.bytes)).servos:
            if op.op is not Op.STOP:
                found[servo_id] = op.angle_cdeg / 100
    return found


def seat() -> dict[int, float]:
    """Where they are in a robot that lies on its belly with its feet on the ground, by the pure engine."""
    engine = Engine(Robot(load()))
    for wanted in (engine.stand, engine.sit):
        wanted()
        for _ in range(500):
            engine.step(STILL, 0.02)
    return {10 * leg + joint: angle for leg in LEGS for joint, angle in zip(JOINTS, engine.pose[leg], strict=True)}


def cut_short(gateway: Gateway, watcher: Client, *signals: signal.Signals) -> tuple[Child, list[FrameRecord]]:
    """A script in mid-walk receives these, each after its answer to the one before; its end, and what was written."""
    written = frames(watcher)
    with gateway.begin("walk", "--forward", "0.08", "--seconds", "600") as child:
        written.wait(lambda frame: frame.cause == Cause.COMMAND, count=6 * 200, timeout_s=60)
        child.send_signal(signals[0])
        for number in signals[1:]:
            child.wait_for_output("once more stops it at once")
            child.send_signal(number)
        child.wait(60)
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None
    return child, written.all


def test_a_script_that_is_ended_early_finishes_its_step_and_sits(gateway: Gateway, watcher: Client) -> None:
    child, records = cut_short(gateway, watcher, signal.SIGTERM)
    assert child.returncode == 130
    assert child.stdout.startswith("ended early: walked 0.")
    assert child.stdout.endswith("it sits, and its servos are stopped\n")
    assert child.stderr == "it finishes its step and sits down; once more stops it at once\n"
    assert stopped_at(records) == pytest.approx(seat(), abs=0.02)


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
