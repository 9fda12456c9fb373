"""The calibration of a real gateway: changed by real clients, on the wire, on the disk, and after a restart."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.model.calibration import ServoMapping
from gateway.model.frames import decode
from gateway.robot.host import calibration_file
from schemas import keys
from schemas.calibration import Calibration, ServoChange
from schemas.telemetry import Reason
from tests.support.fixtures import client_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, frames

MIRRORED = {31: ServoChange(trim_deg=7.5), 32: ServoChange(trim_deg=-10, inverted=True), 33: ServoChange(max_deg=140)}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("state") / "calibration.toml"


@pytest.fixture(scope="module")
def gateway(path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"frames": True},
        "watchdog": {"timeout_ms": 10_000},
        "state": {"path": str(path.parent)},
    }
    with Gateway(tmp_path_factory.mktemp("gateway"), settings) as running:
        yield running


client = client_fixture("anna", rests=True)


def test_the_wire_has_the_servos_angles_the_state_the_users_and_the_disk_the_calibration(
    client: Client, path: Path
) -> None:
    heard, told, news = frames(client), events(client), Heard(client, keys.CALIBRATION, Calibration)
    revision = client.calibration().revision
    assert client.calibrate(MIRRORED, {11: 45}, revision=revision).accepted
    kept = calibration_file.read(path)
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
    assert (state.calibration.revision, state.calibration.fault, state.calibration.kept) == (kept.revision, None, True)
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
            shown = first.run("calibrate", "show")
            assert "revision 1, until the next boot only" in shown.stderr
            assert (
                "The calibration is lost at the next boot" in first.run("calibrate", "set", "11", "--trim", "3").stderr
            )
        with Gateway(tmp_path, settings) as again, again.client() as client:
            assert client.calibration().servos["11"].trim_deg == 3
