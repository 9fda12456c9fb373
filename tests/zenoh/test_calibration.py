"""The calibration of a real gateway: on the wire, on the disk, after a restart, by commands; and a disk at fault."""

import os
import re
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client, GatewayError
from gateway.files import durable
from gateway.host.directories import forgets
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import decode
from gateway.people.client.payloads import calibration_payload
from gateway.people.commands.calibration import once_kept
from gateway.robot.core.calibrating import UNTIL_TRUSTED
from gateway.robot.runtime import calibrations
from schemas import keys
from schemas.ack import Ack
from schemas.calibration import Calibration, ServoCalibration, ServoChange
from schemas.words import Mode, Reason
from tests.support.fixtures import client_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, frames

MIRRORED = {31: ServoChange(trim_deg=7.5), 32: ServoChange(trim_deg=-10, inverted=True), 33: ServoChange(max_deg=140)}

TRIMMED = {"11": ServoCalibration(trim_deg=3)}


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    folder = tmp_path_factory.mktemp("gateway")
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"frames": True},
        "watchdog": {"timeout_ms": 10_000},
        "state": {"path": str(folder)},
    }
    with Gateway(folder, settings) as running:
        yield running


client = client_fixture("anna", rests=True)


def test_the_wire_has_the_servos_angles_the_state_the_users_and_the_disk_the_calibration(
    gateway: Gateway, client: Client
) -> None:
    heard, told, news = frames(client), events(client), Heard(client, keys.CALIBRATION, Calibration)
    revision = client.calibration().revision
    assert client.calibrate(MIRRORED, {11: 45}, revision=revision).accepted
    kept = calibrations.read(gateway.config.with_name("calibration.toml"))
    assert kept is not None
    assert (kept.revision, kept.landing_cdeg) == (revision + 1, {11: 45_00})
    assert kept.of(32) == ServoMapping(-10_00, inverted=True)
    assert news.wait(lambda each: each.revision == kept.revision) == client.calibration()
    assert told.wait(lambda event: event.kind == "calibrated").source == "anna"
    assert client.start_leg(3, 90, 45, 120).accepted
    started = heard.wait(lambda record: not decode(bytes.fromhex(record.bytes)).is_stop)
    sent = {servo: op.angle_cdeg for servo, op in decode(bytes.fromhex(started.bytes)).servos}
    assert sent == {31: 97_50, 32: 125_00, 33: 120_00}
    state = client.state()
    assert [servo.angle_deg for servo in state.legs[2].servos] == [90, 45, 120]
    on_disk = not forgets(gateway.config.parent)  # Debian 13 has a tmpfs at /tmp
    assert state.calibration.kept is on_disk
    assert (state.calibration.revision, state.calibration.fault) == (kept.revision, None)
    beyond = client.set_leg(3, 175, 45, 120, check=False)
    assert (beyond.reason, beyond.detail) == (
        Reason.JOINT_LIMIT,
        "175 degrees of servo 31 are its own 182.5, with its trim; a servo has 0 to 180",
    )
    running = client.calibrate({31: ServoChange(trim_deg=0)}, check=False)
    assert running.reason == Reason.INVALID
    assert "servo 31 runs" in str(running.detail)
    assert client.calibrate({41: ServoChange(trim_deg=1)}).accepted, "leg 4 stands still"


def test_on_a_file_system_that_a_boot_empties_it_does_not_count_as_kept(tmp_path: Path) -> None:
    """As with Raspberry Pi OS's overlay: a restart of the gateway finds it, a boot does not."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        settings = {"state": {"path": folder}}
        with Gateway(tmp_path, settings) as first, first.client() as client:
            first.child.wait_for_output(f"{folder} is on tmpfs, which a boot empties")
            assert client.calibrate({11: ServoChange(trim_deg=2)}).accepted
            assert client.state().calibration.kept is False
            file = tmp_path / "robot.json"
            file.write_text(client.calibration().model_copy(update={"servos": TRIMMED}).model_dump_json())
            assert "is lost at the next boot" in first.run("calibrate", "import", str(file), "--yes").stderr
        with Gateway(tmp_path, settings) as again, again.client() as client:
            assert client.calibration().servos["11"].trim_deg == 3


# ---- the commands of `calibrate`


@pytest.fixture(autouse=True)
def _runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the test a login of its own, for what a shell's lease leaves behind."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_the_landing_pose_is_where_the_running_servos_stand(gateway: Gateway, client: Client) -> None:
    nobody = gateway.run("calibrate", "landing")
    assert nobody.returncode == 1
    assert "no servo of the robot runs" in nobody.stdout
    assert client.start_leg(1, 50, 60, 70).accepted
    assert client.start_leg(2, 80, 85, 90.25).accepted
    unasked = gateway.run("calibrate", "landing")
    assert (unasked.returncode, unasked.stdout.splitlines()[-1]) == (
        1,
        "nothing is written: this is no terminal, so nobody can be asked; --yes agrees",
    )
    before = client.calibration().landing
    end = gateway.run("calibrate", "landing", "--leg", "2", "--yes")
    assert end.returncode == 0, str(end)
    assert re.search(r"^ +23 +90\.25$", end.stdout, re.MULTILINE)
    assert client.calibration().landing == before | {"21": 80, "22": 85, "23": 90.25}
    assert all(servo.running for servo in client.state().legs[0].servos), "it stops nobody, and needs no lease for that"


def test_what_was_exported_comes_back_whole(gateway: Gateway, client: Client, tmp_path: Path) -> None:
    assert client.calibrate({51: ServoChange(trim_deg=2, inverted=True)}, {51: 30}).accepted
    file = tmp_path / "robot.json"
    file.write_text(gateway.run("calibrate", "export").stdout)
    before = client.calibration()
    assert client.calibrate(
        {51: ServoChange(trim_deg=0, inverted=False), 52: ServoChange(trim_deg=9)}, {51: None}
    ).accepted
    assert client.calibrate({}, {52: 20}).accepted
    end = gateway.run("calibrate", "import", str(file), "--yes")
    assert end.returncode == 0, str(end)
    after = client.calibration()
    assert (after.servos, after.landing) == (before.servos, before.landing)
    again = gateway.run("calibrate", "import", str(file), "--yes")
    assert (again.returncode, again.stdout.split(":")[0]) == (0, "there is nothing to change")


# ---- a disk that hangs, and a broken file

TRIM = {31: ServoChange(trim_deg=7.5)}
OWN = RobotCalibration(4, {32: ServoMapping(7_50, inverted=True)})


def until_it_is_being_kept(client: Client) -> Ack:
    """Wait until the change is being kept: a Set for a standing servo is rejected in any case, with the reason."""
    while "being calibrated" not in str((rejected := client.set_leg(3, 90, 90, 90, check=False)).detail):
        assert not rejected.accepted
    return rejected


def test_no_stop_waits_for_a_disk_that_hangs(tmp_path: Path) -> None:
    """More: tests/unit/robot/test_calibration_conductor.py. A pipe that nobody reads holds the write."""
    path = tmp_path / "calibration.toml"
    os.mkfifo(durable.staged_for(path))
    answers: list[Ack] = []
    with (
        Gateway(tmp_path, {"state": {"path": str(tmp_path)}}) as gateway,
        gateway.client() as client,
        Client(gateway.endpoint, timeout_s=60) as patient,
    ):
        asking = threading.Thread(target=lambda: answers.append(patient.calibrate(TRIM, check=False)))
        asking.start()
        assert until_it_is_being_kept(client).reason == Reason.SERVO_STOPPED
        assert client.start_leg(1, 90, 90, 90).accepted
        assert client.estop().stop_frames == 6
        assert client.reset().accepted
        assert asking.is_alive()
        assert not answers
        with durable.staged_for(path).open("rb") as reader:  # the write goes on, and a pipe cannot be synced
            reader.read()
        asking.join(30)
        (ack,) = answers
        assert (ack.accepted, ack.reason) == (False, Reason.INVALID)
        assert client.calibrate(TRIM).accepted
        os.mkfifo(durable.staged_for(path))  # and nobody ever reads this one
        with Client(gateway.endpoint, timeout_s=1.5) as hasty, pytest.raises(GatewayError, match="its disk"):
            once_kept(hasty, calibration_payload({31: ServoChange(trim_deg=8)}))
        until_it_is_being_kept(client)
        gateway.child.terminate()
        assert gateway.child.wait(10) == 0, str(gateway.child)
    kept = calibrations.read(path)
    assert kept is not None
    assert kept.of(31).trim_cdeg == 7_50


def test_a_broken_file_starts_nothing_until_a_person_imports_a_good_one(tmp_path: Path) -> None:
    good, path = tmp_path / "good.json", tmp_path / "calibration.toml"
    text = calibrations.to_toml(OWN).partition("\n[servos.21]")[0]
    calibrations.write(path, RobotCalibration(3))
    calibrations.write(path, OWN)
    path.write_text(text)
    with Gateway(tmp_path, {"state": {"path": str(tmp_path)}}) as gateway, gateway.client() as client:
        logged = gateway.child.wait_for_output("nothing is started until")
        assert f"{UNTIL_TRUSTED}: hexapod-gateway calibrate" in logged
        state = client.state()
        assert (state.mode, state.calibration.revision) == (Mode.IDLE, 4)
        assert str(state.calibration.fault).startswith(f"{path}: the last line is not of_revision = 4")
        assert path.read_text() == text, "a person may want to look at it"
        landing = gateway.run("calibrate", "landing", "--yes")
        assert (landing.returncode, "accept the default in the guide" in landing.stdout) == (1, True)
        good.write_text(Calibration(revision=0, servos=TRIMMED, landing={}).model_dump_json())
        asked = gateway.run("calibrate", "import", str(good))
        assert (asked.returncode, f"{path}: the last line is not" in asked.stdout) == (1, True)
        assert gateway.run("calibrate", "import", str(good), "--yes").returncode == 0
        assert client.state().calibration.fault is None
        assert client.start_leg(1, 90, 90, 90).accepted
        kept = calibrations.read(path)
        assert kept is not None
        assert (kept.revision, kept.servos) == (5, {11: ServoMapping(3_00)})
        assert path.with_name("calibration.broken.toml").read_text() == text
