"""What may go wrong with a calibration's file: a disk that hangs, and a broken file."""

import os
import threading
from pathlib import Path

import pytest

from gateway import durable
from gateway.client import Client
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.people.commands.calibration import NotKeptYetError, once_kept
from gateway.robot.host import calibration_file
from schemas.calibration import ServoChange
from schemas.telemetry import Ack, Mode, Reason
from tests.support.gateway_process import Gateway
from tests.support.heard import events

TRIM = {31: ServoChange(trim_deg=7.5)}
OWN = RobotCalibration(4, {32: ServoMapping(7_50, inverted=True)})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    folder = tmp_path / "state"
    folder.mkdir()
    return folder / "calibration.toml"


def until_it_is_being_kept(client: Client) -> Ack:
    """A Set for a servo that stands still is rejected in any case; the sentence says whether the change has come."""
    while "being calibrated" not in str((rejected := client.set_leg(3, 90, 90, 90, check=False)).detail):
        assert not rejected.accepted
    return rejected


def test_no_stop_waits_for_a_disk_that_hangs(tmp_path: Path, path: Path) -> None:
    """A pipe that nobody reads holds the write for as long as the test wants."""
    os.mkfifo(durable.staged_for(path))
    answers: list[Ack] = []
    with (
        Gateway(tmp_path, {"state": {"path": str(path.parent)}}) as gateway,
        gateway.client() as client,
        Client(gateway.endpoint, timeout_s=60) as patient,
    ):
        told = events(client)
        asking = threading.Thread(target=lambda: answers.append(patient.calibrate(TRIM, check=False)))
        asking.start()
        rejected = until_it_is_being_kept(client)
        assert rejected.reason == Reason.SERVO_STOPPED
        assert client.start_leg(1, 90, 90, 90).accepted
        told.wait(lambda event: event.kind == "watchdog_expired" and event.legs == (1,))
        assert client.start_leg(1, 90, 90, 90).accepted
        assert client.estop().stop_frames == 6
        assert client.reset().accepted
        assert client.calibrate({61: ServoChange(trim_deg=1)}, check=False).reason == Reason.STALE, (
            "one after the other"
        )
        assert asking.is_alive()
        assert not answers
        with durable.staged_for(path).open("rb") as reader:  # the write goes on, and a pipe cannot be synced
            reader.read()
        asking.join(30)
        (ack,) = answers
        assert (ack.accepted, ack.reason) == (False, Reason.INVALID)
        assert client.calibrate(TRIM).accepted
        os.mkfifo(durable.staged_for(path))  # and nobody ever reads this one
        with Client(gateway.endpoint, timeout_s=1.5) as hasty, pytest.raises(NotKeptYetError, match="its disk"):
            once_kept(hasty, lambda: hasty.calibrate({31: ServoChange(trim_deg=8)}, check=False))
        until_it_is_being_kept(client)
        gateway.child.terminate()
        assert gateway.child.wait(10) == 0, str(gateway.child)
    kept = calibration_file.read(path)
    assert kept is not None
    assert kept.of(31).trim_cdeg == 7_50


def test_a_broken_file_starts_nothing_until_a_person_takes_the_default(tmp_path: Path, path: Path) -> None:
    text = calibration_file.to_toml(OWN).partition("\n[servos.21]")[0]
    calibration_file.write(path, RobotCalibration(3))
    calibration_file.write(path, OWN)
    path.write_text(text)
    with Gateway(tmp_path, {"state": {"path": str(path.parent)}}) as gateway, gateway.client() as client:
        logged = gateway.child.wait_for_output("nothing is started until")
        assert "hexapod-gateway calibrate accept-default" in logged
        state = client.state()
        assert (state.mode, state.calibration.revision) == (Mode.IDLE, 4)
        assert str(state.calibration.fault).startswith(f"{path}: end: is missing;")
        assert path.read_text() == text, "a person may want to look at it"
        asked = gateway.run("calibrate", "accept-default")
        assert (asked.returncode, f"{path}: end: is missing" in asked.stdout) == (1, True)
        landing = gateway.run("calibrate", "landing", "--yes")
        assert (landing.returncode, "calibrate accept-default" in landing.stdout) == (1, True)
        assert gateway.run("calibrate", "accept-default", "--yes").returncode == 0
        assert client.state().calibration.fault is None
        assert client.start_leg(1, 90, 90, 90).accepted
        kept = calibration_file.read(path)
        assert kept is not None
        assert (kept.revision, kept.servos) == (5, {})
        assert path.with_name("calibration.broken.toml").read_text() == text
