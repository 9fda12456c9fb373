"""`replay` against a real gateway: it writes again what was recorded, or says what differs."""

import signal
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.client import Client
from gateway.geometry import load
from gateway.model.frames import OneServo, Op, ServoOp, decode, stop_leg
from gateway.people.recordings import Recording, read
from gateway.people.walking import STILL, Engine
from gateway.people.walking import Robot as GeometryRobot
from schemas.calibration import ServoChange
from schemas.keys import FRAME
from schemas.telemetry import Cause, FrameRecord
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames

pytestmark = [pytest.mark.full, pytest.mark.alone]

WATCHDOG_MS: Final = 400
SETTINGS: Final[dict[str, dict[str, Any]]] = {"telemetry": {"frames": True}, "watchdog": {"timeout_ms": WATCHDOG_MS}}
gateway = gateway_fixture(SETTINGS)


def of_each_leg(frames: Sequence[FrameRecord]) -> dict[int, list[str]]:
    """What was written to each leg, without the repeats of Stops, of which the end of a stream leaves some out."""
    found: dict[int, list[str]] = {}
    for record in frames:
        if record.cause != Cause.REPEAT:
            found.setdefault(decode(bytes.fromhex(record.bytes)).leg, []).append(record.bytes)
    return found


def without_stops(frames: Sequence[str]) -> list[str]:
    """A leg's Stop that comes while another is repeated may be merged with it."""
    return [frame for frame in frames if not decode(bytes.fromhex(frame)).is_stop]


def ride(robot: Client) -> list[FrameRecord]:
    """A second of standing up, a servo alone, a leg that falls silent, an emergency stop: all frames."""
    heard = frames(robot)
    engine = Engine(GeometryRobot(load()))
    engine.stand()
    with robot.stream(50) as stream:
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < 1:
            stream.set(engine.step(STILL, 0.02))
    stop = stop_leg(6).to_bytes().hex()
    stopped_ns = heard.wait(lambda record: record.cause == "command" and record.bytes == stop).monotonic_ns
    heard.wait(lambda record: record.cause == "repeat" and record.monotonic_ns > stopped_ns, count=18)
    assert robot.servo(32, "start", 12.34).accepted
    assert robot.servo(32, "set", 20).accepted
    watchdog_ns = heard.wait(lambda record: record.cause == "watchdog").monotonic_ns
    heard.wait(lambda record: record.cause == "repeat" and record.monotonic_ns > watchdog_ns, count=3)
    with robot.stream(50) as stream:  # for longer than what is still repeated
        for step in range(10):
            stream.set({5: (90 + step, 90, 90)})
        robot.estop()
    heard.wait(lambda record: record.cause == "repeat" and record.bytes.startswith("0e0133"), count=6)
    assert robot.reset().accepted
    return heard.all


@pytest.fixture(scope="module")
def recorded(gateway: Gateway, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "ride.mcap"
    with gateway.client(source="a ride") as robot, Recording(path, time_ns=time.time_ns()) as recording:
        for record in ride(robot):
            recording.add_report(FRAME, record.model_dump(mode="json"), time.time_ns())
    return path


def test_the_simulated_gateway_writes_the_same_frames_again(gateway: Gateway, recorded: Path) -> None:
    """Those of a command, of the watchdog, and of an emergency stop; a Stop of all legs ends it."""
    before = [FrameRecord.model_validate(message.content) for message in read(recorded, topics=(FRAME,))]
    with gateway.client() as client:
        heard = frames(client)
        again = gateway.run("replay", str(recorded))
        assert again.returncode == 0, str(again)
        after = heard.all
    written = of_each_leg(after)
    for leg, expected in of_each_leg(before).items():
        rest = iter(expected)
        assert all(frame in rest for frame in without_stops(written[leg])), "nothing else, and in the same order"
        assert len(without_stops(written[leg])) > 0.9 * len(without_stops(expected)), "a stall merges setpoints"
        assert [written[leg][0], written[leg][-1]] == [expected[0], stop_leg(leg).to_bytes().hex()]


def test_a_rejection_ends_it_with_all_legs_stopped(tmp_path: Path, recorded: Path) -> None:
    settings: dict[str, dict[str, Any]] = {"limits.servos.32": {"max_deg": 15}, "watchdog": {"timeout_ms": 2000}}
    with Gateway(tmp_path, settings) as other, other.client() as client:
        heard = events(client)
        ended = other.run("replay", str(recorded), "--speed", "2")
        assert ended.returncode == 1, str(ended)
        assert "joint_limit" in ended.stderr
        assert "all legs are stopped" in ended.stderr
        heard.wait(lambda event: event.kind == "command_rejected")
        assert client.state().mode == "idle"


def test_who_takes_the_lease_from_it_drives_on(gateway: Gateway, recorded: Path) -> None:
    with gateway.client(source="bert") as bert:
        heard, happened = frames(bert), events(bert)
        with gateway.begin("replay", str(recorded), "--speed", "0.2") as child:
            heard.wait(lambda record: record.cause == "command", count=60)
            with bert.lease(take=True), bert.stream(50) as stream:
                stream.set({1: (90, 90, 90)})
                while child.returncode is None:
                    stream.set({1: (90, 90, 90)})
                for _ in range(10):
                    stream.set({1: (90, 90, 90)})
            assert child.wait() == 1, str(child)
        assert "not_holder" in child.stderr
        assert "all legs are stopped" not in child.stderr
        assert any(event.reason == "not_holder" for event in happened.all)


def test_whoever_ends_it_finds_all_legs_stopped(gateway: Gateway, recorded: Path) -> None:
    with gateway.client() as client:
        heard = frames(client)
        with gateway.begin("replay", str(recorded)) as child:
            heard.wait(lambda record: record.cause == "command", count=60)
            child.send_signal(signal.SIGINT)
            assert child.wait() == 1, str(child)
        assert "all legs are stopped" in child.stderr
        assert client.state().mode == "idle"


def test_a_robot_that_moves_already_and_a_file_without_frames_are_reported(gateway: Gateway, recorded: Path) -> None:
    with gateway.client() as client:
        assert client.start_leg(1, 90, 90, 90).accepted
        with client.stream(50) as stream:
            stream.set({1: (90, 90, 90)})
            with gateway.begin("replay", str(recorded)) as busy:
                while busy.returncode is None:
                    stream.set({1: (90, 90, 90)})
                busy.wait()
                assert busy.returncode == 2, str(busy)
                assert "a servo runs; stop it first" in busy.stderr
    empty = recorded.with_name("empty.mcap")
    Recording(empty, time_ns=time.time_ns()).close()
    nothing = gateway.run("replay", str(empty))
    assert nothing.returncode == 2
    assert "telemetry.frames" in nothing.stderr


def test_on_another_calibration_it_makes_the_same_motion(tmp_path: Path, recorded: Path) -> None:
    path = tmp_path / "calibrated.mcap"
    with Gateway(tmp_path, SETTINGS) as other, other.client() as robot:
        assert robot.calibrate({11: ServoChange(trim_deg=20), 12: ServoChange(inverted=True)}).accepted
        with other.begin("record", str(path)) as recorder:
            recorder.wait_for_output("Ctrl-C ends it")
            heard = frames(robot)
            with robot.stream(50) as stream:
                for step in range(10):
                    stream.set({1: (90 + step, 45, 120)})
            stop = stop_leg(1).to_bytes().hex()
            heard.wait(lambda record: record.cause == "command" and record.bytes == stop)
            recorder.send_signal(signal.SIGINT)
            assert recorder.wait() == 0, str(recorder)
        was = [record.bytes for record in heard.all if record.cause == "command"]
        assert was[0].startswith("0e010b016e000c0187")  # 110 and 135 degrees
        assert robot.calibrate({11: ServoChange(trim_deg=-20), 12: ServoChange(inverted=False)}).accepted
        again = other.run("replay", str(path))
        assert again.returncode == 0, str(again)
        now = [record.bytes for record in heard.all if record.cause == "command"][len(was) :]
        assert now[0].startswith("0e010b0146000c012d")  # 70 and 45
        unknown = other.run("replay", str(recorded))
        assert unknown.returncode == 2, str(unknown)
        assert "does not contain the calibration" in unknown.stderr


def test_the_last_setpoint_is_not_rejected_for_the_stops_at_the_end(gateway: Gateway, tmp_path: Path) -> None:
    path = tmp_path / "short.mcap"
    with Recording(path, time_ns=time.time_ns()) as recording:
        for step, op in enumerate((Op.START, Op.SET)):
            frame = OneServo(11, ServoOp(op, 9000 + step)).to_bytes().hex()
            record = FrameRecord(time=datetime.now(UTC), monotonic_ns=step * 10**6, bytes=frame, cause=Cause.COMMAND)
            recording.add_report(FRAME, record.model_dump(mode="json"), time.time_ns())
    with gateway.client() as client:
        heard = frames(client)
        done = gateway.run("replay", str(path))
        assert done.returncode == 0, str(done)
        assert frame in [record.bytes for record in heard.all], "it is carried out, and not dropped for the Stops"
