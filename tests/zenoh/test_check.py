"""`check` looks at real sockets, certificates, files, a gateway; `--move` moves one servo, and stops it at any end."""

import io
import json
import signal
import socket
import sys
from collections import ChainMap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway import geometry
from gateway.client import Client
from gateway.model.frames import OneServo, Op, ServoOp, decode
from gateway.onboard.check import move as module
from gateway.onboard.check import security
from gateway.onboard.check.table import CheckedRobot
from gateway.people.walking.planning import lying_deg
from gateway.people.walking.robot import Robot
from schemas.event import FrameRecord
from schemas.words import Cause, Mode, Reason
from tests.support.child import Child
from tests.support.command import Ended, run_here
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import Gateway, free_port, write_settings
from tests.support.heard import Heard, frames, is_stop, states

SPI = {"spi": {"framing": "length-prefixed"}}


# ---- the command


def test_each_fault_of_the_configuration_is_a_line_and_the_rest_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HEXAPOD_LOG__LEVEL", "loud")
    monkeypatch.setenv("HEXAPOD_CONNECT", f"tcp/127.0.0.1:{free_port()}")  # which hides no file that is named
    config = tmp_path / "gateway.toml"
    config.write_text('[spi]\nframing = "plain"\nspeed_hz = 0\n[wings]\n')
    said = run_here("check", "--config", str(config))
    assert (said.returncode, said.stderr) == (1, "")
    *found, last = said.stdout.splitlines()
    faults = [line for line in found if line.startswith("failure  configuration")]
    assert len(faults) == 3
    for place in ("spi.speed_hz", "wings", "HEXAPOD_LOG__LEVEL"):
        assert any(place in fault for fault in faults), said.stdout
    assert any(line[9:].startswith("systemd unit") for line in found), said.stdout
    for line in found:
        assert line.split()[0] in ("ok", "warning", "failure"), line
        assert (" → " in line) is not line.startswith("ok"), line
    assert last.startswith("This machine cannot run the service: 3 failures, ")


def test_check_prints_the_same_as_json_for_programs(tmp_path: Path) -> None:
    config = write_settings(tmp_path / "gateway.toml", SPI)
    shown, found = (run_here("check", "--config", str(config), *options) for options in ((), ("--json",)))
    report = json.loads(found.stdout)
    assert found.returncode == shown.returncode == int(not report["passed"])
    told = [f"{each['verdict']:8} {each['name']:14} {each['sentence']}" for each in report["checks"]]
    assert [line.partition(" → ")[0] for line in shown.stdout.splitlines()[:-1]] == told


# ---- ports (one on which a gateway answers: tests/hil/test_service.py)


@pytest.fixture
def taken() -> Iterator[int]:
    """Yield a port of the loopback on which another program listens, and over UDP as well."""
    with socket.socket() as listener, socket.socket(type=socket.SOCK_DGRAM) as holder:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        holder.bind(("127.0.0.1", port))
        yield port


TAKEN, FREE, RUNS = "is held by another program", "is free", "by the running gateway"


@pytest.mark.parametrize(
    ("endpoint", "sentence"),
    [
        *((f"{each}:TAKEN", TAKEN) for each in ("tcp/127.0.0.1", "tls/127.0.0.1", "quic/127.0.0.1")),
        *((f"{each}:FREE", FREE) for each in ("tcp/127.0.0.1", "tls/127.0.0.1", "quic/127.0.0.1")),
        ("tcp/127.0.0.1:TAKEN#iface=lo", TAKEN),
        ("tcp/192.0.2.1:7447", "is not there yet (Cannot assign requested address)"),
        ("tcp/127.0.0.1:99999", "cannot be listened on: ports end at 65535"),
        ("tcp/no-such-host.invalid:7447", "is not there yet ("),
        ("unixsock-stream//run/hexapod.sock", "was not tried"),
    ],
)
def test_check_names_what_holds_a_port(endpoint: str, sentence: str, taken: int) -> None:
    where = endpoint.replace("TAKEN", str(taken)).replace("FREE", str(free_port()))
    assert said(CheckedRobot(), where).startswith(f"{where} {sentence}")
    if sentence is TAKEN:
        assert said(CheckedRobot(gateway_runs=True), where) == f"{where} is in use {RUNS}"


def said(robot: CheckedRobot, where: str) -> str:
    found = security.port(robot, where)
    assert found is not None
    return found.sentence


# Patient, for a busy machine: no servo is stopped but by command; and each test starts where it says.
gateway = gateway_fixture(
    {"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 9000}, "limits": {"takeover_deg_s": 0}}
)


client = client_fixture(None, rests=True)


@pytest.fixture
def move(gateway: Gateway, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Ended]:
    """Move it in this process, with these answers, and briefly."""
    monkeypatch.setattr(module, "_HOLD_S", 0.2)

    def here(*answers: str, options: tuple[str, ...] = ()) -> Ended:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{answer}\n" for answer in answers)))
        return gateway.run("check", "--move", *options)

    return here


@contextmanager
def moving(gateway: Gateway, heard: Heard[FrameRecord], after: Op = Op.SET) -> Iterator[Child]:
    """Yield a process that has just started servo 61, or set it."""
    with gateway.begin("check", "--move", "--yes") as child:
        heard.wait(lambda record: decode(bytes.fromhex(record.bytes)) == OneServo(61, ServoOp(after, 9000)))
        yield child


def until_stopped(heard: Heard[FrameRecord], servo_id: int) -> list[OneServo]:
    """Return what was written for single servos, up to the Stop for this one."""
    heard.wait(lambda record: decode(bytes.fromhex(record.bytes)) == OneServo(servo_id, ServoOp(Op.STOP)))
    return servo_frames(heard)


def servo_frames(heard: Heard[FrameRecord]) -> list[OneServo]:
    """Return what was written for single servos by command, repeats of one target once."""
    found = [decode(bytes.fromhex(record.bytes)) for record in heard.all if record.cause == Cause.COMMAND]
    servo = [frame for frame in found if isinstance(frame, OneServo)]
    return [frame for place, frame in enumerate(servo) if not place or servo[place - 1] != frame]


def start_set_stop(servo_id: int, angle_deg: int, end_deg: int) -> list[OneServo]:
    ops = [
        ServoOp(Op.START, angle_deg * 100),
        ServoOp(Op.SET, angle_deg * 100),
        ServoOp(Op.SET, end_deg * 100),
        ServoOp(Op.STOP),
    ]
    return [OneServo(servo_id, op) for op in ops]


@pytest.mark.parametrize(
    ("answers", "expected", "leg_1"),
    [
        (("", "", "yes", "yes", "yes"), start_set_stop(61, 90, 95), False),
        (("12", "178", "yes", "yes", "yes"), start_set_stop(12, 178, 173), True),
    ],
)
def test_one_servo_is_started_moved_and_stopped(
    move: Callable[..., Ended], client: Client, answers: tuple[str, ...], expected: list[OneServo], leg_1: bool
) -> None:
    """The command is silent about leg 1's other Stops in a call."""
    heard = frames(client)
    end = move(*answers)
    assert end.returncode == 0, str(end)
    assert until_stopped(heard, expected[0].servos[0][0]) == expected
    assert "will go to " in end.stderr
    assert "is stopped." in end.stderr
    assert ("try a servo of leg 6" in end.stdout) is leg_1
    assert client.state().mode is Mode.IDLE


def test_causes_are_listed_if_the_servo_did_not_move(move: Callable[..., Ended], client: Client) -> None:
    heard = frames(client)
    end = move("", "", "yes", "no")
    assert end.returncode == 1, str(end)
    assert until_stopped(heard, 61) == start_set_stop(61, 90, 95), "and nothing by itself after that"
    causes = [line.split()[1] for line in end.stdout.splitlines() if line[:1].isdigit()]
    assert causes == ["Supply:", "Framing:", "Reset:", "Wiring:", "Chip", "The"]
    assert "the gateway speaks plain" in end.stdout


@pytest.mark.parametrize("answers", [("", "", "y"), ("11", "90", "no"), ("10",), ("", "nan")])
def test_without_consent_nothing_moves(move: Callable[..., Ended], client: Client, answers: tuple[str, ...]) -> None:
    heard = frames(client)
    assert move(*answers).returncode == 2
    assert client.state().mode is Mode.IDLE
    assert servo_frames(heard) == []


@pytest.mark.parametrize("after", [Op.START, Op.SET])
def test_ctrl_c_stops_the_servo(gateway: Gateway, client: Client, after: Op) -> None:
    heard = frames(client)
    with moving(gateway, heard, after) as child:
        child.send_signal(signal.SIGINT)
        assert child.wait() == 130, str(child)
    assert until_stopped(heard, 61)[-1] == OneServo(61, ServoOp(Op.STOP)), "by command, not by the watchdog"
    assert "Servo 61 is stopped." in child.stderr
    assert client.state().mode is Mode.IDLE


def test_a_servo_that_somebody_else_stops_is_not_started_again(gateway: Gateway, client: Client) -> None:
    heard = frames(client)
    with moving(gateway, heard) as child:
        assert client.start_leg(1, 90, 90, 90, check=False).reason == Reason.NOT_HOLDER, "it has the lease"
        assert client.stop().accepted
        assert child.wait() == 1, str(child)
    assert "a set was rejected: servo_stopped: " in child.stderr
    assert [op.op for frame in servo_frames(heard) for _, op in frame.servos].count(Op.START) == 1
    assert client.state().lease.holder is None


def test_a_robot_that_is_not_at_rest_is_not_moved(move: Callable[..., Ended], client: Client) -> None:
    client.estop()
    heard = frames(client)
    end = move(options=("--yes",))
    assert end.returncode == 2, str(end)
    assert "leave the emergency stop first" in end.stderr
    assert client.reset().accepted
    with client.lease():
        end = move(options=("--yes",))
    assert end.returncode == 2, str(end)
    assert "drives, and nothing is moved" in end.stderr
    assert servo_frames(heard) == []


# ---- a robot that starts and stops as a whole

WHOLE: dict[str, dict[str, object]] = {
    "wire": {"name": "elkapod-2025"},
    "telemetry": {"frames": True},
    "watchdog": {"timeout_ms": 9000},
}


def legs_written(heard: Heard[FrameRecord]) -> list[tuple[Op, dict[int, int]]]:
    """Return operation and angles of all six legs of each command, repeats of one target once."""
    records = [record for record in heard.all if record.cause == Cause.COMMAND]
    found = [dict(decode(bytes.fromhex(record.bytes)).servos) for record in records]
    whole = [dict(ChainMap(*found[at : at + 6])) for at in range(0, len(found), 6)]
    kinds = [(next(iter(each.values())).op, {servo: op.angle_cdeg for servo, op in each.items()}) for each in whole]
    return [each for place, each in enumerate(kinds) if not place or kinds[place - 1] != each]


def test_all_legs_start_lying_one_servo_moves_and_all_are_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_HOLD_S", 0.2)
    monkeypatch.setattr(sys, "stdin", io.StringIO("23\n\nyes\nyes\nyes\n"))
    with Gateway(tmp_path, WHOLE) as gateway, gateway.client() as client:
        states(client).wait(lambda state: state.controller.alive is True)
        heard = frames(client)
        end = gateway.run("check", "--move")
        heard.wait(is_stop)
        assert client.state().mode is Mode.IDLE
    assert end.returncode == 0, str(end)
    assert "all 18 servos will go at once to its lying pose" in end.stderr
    assert "All servos are stopped." in end.stderr
    start, held, moved, stopped = legs_written(heard)[:4]
    assert [op for op, _ in (start, held, moved, stopped)] == [Op.START, Op.SET, Op.SET, Op.STOP]
    assert start[1] == held[1]
    assert {servo: moved[1][servo] - angle for servo, angle in start[1].items() if moved[1][servo] != angle} == {
        23: 500
    }
    assert start[1] == {servo: round(100 * at) for servo, at in lying_deg(Robot(geometry.load())).items()}
