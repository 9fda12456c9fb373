"""Each example runs as it stands, against a gateway with a simulated controller."""

import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import tomllib
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Final

import pytest

from gateway.client import Client
from gateway.model.frames import OneLeg, Op, centidegrees, decode
from schemas.event import FrameRecord
from schemas.robot import SERVO_IDS
from schemas.words import Cause
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import COMMAND, READY, Gateway, free_port
from tests.support.heard import Heard, events, frames, is_stop, last_angles
from tests.unit.people.test_recordings import recorded

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("client")]

EXAMPLES = Path(__file__).parents[2] / "examples"
ELKAPOD: Final = EXAMPLES / "elkapod" / "gateway.toml"
MIRRORED: Final = ("22", "23", "42", "43", "62", "63")
"""What the walk knows nothing of, and the wire shows."""
SWUNG_DEG: Final = 95
"""The first joint of leg 3 goes so far when it walks, and stays at 90 while the robot stands up."""

gateway = gateway_fixture({"telemetry": {"frames": True}})
# It outlasts a moment in which this machine is busy.
patient = gateway_fixture({"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 2000}})


client = client_fixture(None, rests=True)


def run(name: str, gateway: Gateway, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / name), "--connect", gateway.endpoint, *arguments]
    with Child(command, os.environ) as child:
        assert child.wait() == 0, child.stderr
    return child.stdout


def moved(heard: Heard[FrameRecord]) -> dict[int, set[int]]:
    """Return the angles, in hundredths of a degree, that commands set for each servo."""
    angles: dict[int, set[int]] = {}
    for record in heard.all:
        if record.cause is Cause.COMMAND:
            for servo_id, op in decode(bytes.fromhex(record.bytes)).servos:
                if op.op is not Op.STOP:
                    angles.setdefault(servo_id, set()).add(op.angle_cdeg)
    return angles


def test_every_example_is_run_here() -> None:
    here = Path(__file__).read_text()
    for path in EXAMPLES.rglob("*.py"):
        if path.parent.name in {"lerobot", "ros2", "wire_pca9685", "wire_maestro"}:  # test_lerobot.py, tests/ros2, …
            continue
        assert f'"{path.relative_to(EXAMPLES)}"' in here


@pytest.mark.parametrize(
    ("name", "said", "moved_servos"),
    [
        ("first.py", ["does not run; start it before you set it", "accepted=True"], {*SERVO_IDS}),
        ("plain_zenoh.py", ["'accepted': True"], {31, 32, 33}),
        (
            "session.py",
            ["event: watchdog_expired no command for leg 1 in 250 ms", "does not run; start it before you set it",
             "6 Stop frames within", "; the emergency stop was engaged by session, ", "Jitter("],
            {11, 12, 13},
        ),
        ("arrays.py", ["Jitter("], {*SERVO_IDS}),
    ],
)  # fmt: skip
def test_each_example_prints_and_moves_what_it_should(
    gateway: Gateway, patient: Gateway, name: str, said: list[str], moved_servos: set[int]
) -> None:
    robot, options = gateway if name == "session.py" else patient, ("--seconds", "1") * (name == "arrays.py")
    with robot.client() as client:
        heard = frames(client)
        printed = run(name, robot, *options)
        assert [text for text in said if text not in printed] == [], printed
        heard.wait(is_stop)
        heard.wait_for_all(lambda _: moved(heard).keys() >= moved_servos)


def test_the_first_program_and_the_first_command_work_on_a_robot_that_starts_as_a_whole(tmp_path: Path) -> None:
    help_text = run_here("--help").stdout
    (command,) = re.findall(r"hexapod-gateway (send [a-z0-9 ]+--hold) 5", " ".join(help_text.replace("│", " ").split()))
    with Gateway(tmp_path, {"wire": {"name": "elkapod-2025"}, "watchdog": {"timeout_ms": 2000}}) as whole:
        assert run("first.py", whole).count("accepted=True") == 2
        first = run_here(*command.split(), "0.2", "--connect", whole.endpoint)
        assert (first.returncode, first.stdout) == (0, "accepted\n"), first
        with whole.client() as client:
            assert client.state().watchdog.expirations == 0


def test_a_gait_that_recovers(patient: Gateway) -> None:
    """It recovers from an emergency stop that a person has reset, and not from somebody's Stop."""
    arguments = ["--connect", patient.endpoint, "--seconds", "60"]
    with patient.client() as client:
        told, written = events(client), frames(client)
        gait = Child([sys.executable, str(EXAMPLES / "recover.py"), *arguments], os.environ)
        written.wait(moves, count=60)  # all legs have started
        stopped = client.estop()
        gait.wait_for_output("ended: the emergency stop was engaged by test, ")
        rejected = client.state().commands.rejected
        again = frames(client)
        assert client.reset(stopped.estop).accepted
        gait.wait_for_output("goes on")
        again.wait(moves, count=60)
        assert client.state().commands.rejected - rejected <= 1, "it asks for the state, and starts nothing meanwhile"
        client.stop()
        assert gait.wait() == 1
        gait.close()
        assert "test stopped all legs, " in gait.stderr
        assert not any(leg.running for leg in client.state().legs)
        assert not [event for event in told.all if event.kind == "watchdog_expired"]


def test_the_tripod_gait_goes_on_after_somebody_elses_stop_where_that_was_decided(patient: Gateway) -> None:
    command = [sys.executable, str(EXAMPLES / "tripod_gait.py"), "--connect", patient.endpoint, "--seconds", "2"]
    with patient.client() as client:
        written, rejected = frames(client), client.state().commands.rejected
        child = Child([*command, "--start-again"], os.environ)
        written.wait(swings, timeout_s=30)
        first = [decode(bytes.fromhex(record.bytes)) for record in written.all if record.cause is Cause.COMMAND][:6]
        assert [frame.leg for frame in first if isinstance(frame, OneLeg)][:2] in ([1, 2], [1, 1]), "leg after leg"
        assert client.state().commands.rejected == rejected
        client.stop(3)
        assert child.wait() == 0, child.stderr
        child.close()
        assert "starting again: test stopped leg 3, " in child.stdout
        assert not any(servo.running for leg in client.state().legs for servo in leg.servos), "it is stopped"
    assert re.search(r"^walked 0\.\d\d m ahead, -?0\.0\d m to the left, turned by 0\.\d\d rad$", child.stdout, re.M)
    angles = moved(written)
    assert len(angles) == 18
    assert all(len(each) >= 5 for each in angles.values()), "every servo goes through many angles"


def test_a_recording_is_played_again(patient: Gateway, tmp_path: Path) -> None:
    ride = tmp_path / "ride.mcap"
    with patient.begin("record", str(ride)) as recorder, patient.client() as robot:
        recorder.wait_for_output("recording into")
        written = frames(robot)
        with robot.stream(50) as stream:
            for step in range(50):
                stream.set({3: (90, 45 + step % 25, 120), 4: (90, 45, 120)})
        written.wait(is_stop)
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait() == 0, str(recorder)
        again = frames(robot)
        assert "replayed: " in run("replay.py", patient, str(ride))
        again.wait(is_stop)
        assert moved(again).keys() == moved(written).keys() == {31, 32, 33, 41, 42, 43}
        assert moved(again)[32] <= moved(written)[32], "what comes between two of its ticks is left out"
        assert max(moved(again)[32]) - min(moved(again)[32]) >= 15_00


def test_a_recording_without_its_end_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    ride = tmp_path / "ride.mcap"
    recorded(ride)
    example = runpy.run_path(str(EXAMPLES / "replay.py"))
    whole = list(example["poses"](ride))
    ride.write_bytes(ride.read_bytes()[:-200])
    assert list(example["poses"](ride)) == whole
    ride.write_bytes(ride.read_bytes()[: ride.stat().st_size // 2])
    assert len(list(example["poses"](ride))) <= len(whole)


def test_a_leg_that_runs_goes_slowly_to_the_first_pose() -> None:
    """Each setpoint is a few degrees further; a leg at rest starts where the recording begins."""
    example = runpy.run_path(str(EXAMPLES / "replay.py"))
    way = list(example["eased"]({1: (0.0, 90.0, 90.0)}, {1: (90.0, 90.0, 90.0), 2: (10.0, 20.0, 30.0)}, 180))
    assert [each[1][0] for each in way] == pytest.approx([3.6 * step for step in range(1, 26)])
    assert {each[2] for each in way} == {(10.0, 20.0, 30.0)}
    assert way[-1][1] == (90.0, 90.0, 90.0)


def test_a_real_robot_is_moved_on_request_only(tmp_path: Path) -> None:
    example = runpy.run_path(str(EXAMPLES / "replay.py"))

    real = SimpleNamespace(state=lambda: SimpleNamespace(simulated=False))
    example["main"].__globals__["Client"] = lambda *_, **__: nullcontext(real)
    with pytest.raises(SystemExit, match="--real moves it"):
        example["main"](tmp_path / "ride.mcap", "nowhere", False)


def test_a_recording_in_rerun_brings_its_blueprint(tmp_path: Path) -> None:
    ride, made = tmp_path / "ride.mcap", tmp_path / "ride.rrd"
    recorded(ride)
    example = EXAMPLES / "rerun_view.py"
    subprocess.run([sys.executable, example, ride, "--save", made], capture_output=True, check=True)
    rerun = Path(sys.executable).with_name("rerun")
    found = subprocess.run([rerun, "rrd", "print", made], capture_output=True, text=True, check=True).stdout
    entities = set(re.findall(r" - (/\S*) - data columns", found))
    assert any(each.startswith("/off/") for each in entities), "servos that are off"
    assert "ViewportBlueprint:root_container" in found, "the file brings its blueprint"


def test_the_elkapod_whose_gait_is_killed_lands_and_is_stopped(tmp_path: Path) -> None:
    """With its own limits, speed, landing and calibration; and the incident tells it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    shutil.copy(ELKAPOD.with_name("calibration.toml"), tmp_path)
    env = {
        **os.environ,
        "HEXAPOD_ZENOH__LISTEN": f'["{endpoint}"]',
        "HEXAPOD_STATE__PATH": str(tmp_path),
        "HEXAPOD_WATCHDOG__TIMEOUT_MS": "1000",  # outlasts a moment in which this machine is busy
    }
    with Child([*COMMAND, "run", "--sim", "--config", str(ELKAPOD)], env) as gateway:
        gateway.wait_for_output(READY, timeout_s=20)
        with Client(endpoint, source="test") as client:
            written, told = frames(client), events(client)
            gait = Child([sys.executable, str(EXAMPLES / "elkapod/gait.py"), "--connect", endpoint], env)
            written.wait(swings, timeout_s=30)
            os.kill(gait.pid, signal.SIGKILL)
            gait.close()
            told.wait(lambda event: event.kind == "watchdog_expired")
            assert client.state().commands.rejected == 0
            assert {servo // 10 for servo in moved(written)} == {1, 2, 3, 4, 5, 6}
            landing = tomllib.loads(ELKAPOD.read_text())["watchdog"]["landing"]
            pose = {int(servo): 180 - deg if servo in MIRRORED else deg for servo, deg in landing.items()}
            written.wait_for_all(lambda records: last_angles(records) == pytest.approx(pose, abs=0.01))
        with Child([*COMMAND, "incidents", "show", "last", "--config", str(ELKAPOD)], env) as shown:
            assert shown.wait() == 0, shown.stderr
        assert "Before it, elkapod gait sent" in shown.stdout
        assert "the robot went to its landing pose" in shown.stdout
        assert "Stop written to all legs" in shown.stdout


def moves(record: FrameRecord) -> bool:
    """Return whether a program moves a servo by it."""
    return record.cause is Cause.COMMAND and not is_stop(record)


def swings(record: FrameRecord) -> bool:
    """Return whether it walks already; before that the robot stands up."""
    return any(
        servo_id == 31 and op.op is not Op.STOP and op.angle_cdeg > centidegrees(SWUNG_DEG)
        for servo_id, op in decode(bytes.fromhex(record.bytes)).servos
    )
