"""The calibration on disk: what is written is read again, and what is broken in any way is an error."""

from pathlib import Path

import pytest
from hypothesis import given

from gateway.errors import ConfigError
from gateway.host.directories import state_directory, state_to_read
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.robot.runtime.calibrations import (
    EARLIER_KEPT,
    MAX_CALIBRATION_BYTES,
    from_toml,
    load,
    previous,
    read,
    to_toml,
    write,
)
from tests.unit.model.test_calibration import calibrations

OWN = RobotCalibration(3, {32: ServoMapping(7_50, inverted=True, max_cdeg=140_00)}, {31: 90_00, 32: 45_25})


@given(calibrations)
def test_what_is_written_is_read_again(calibration: RobotCalibration) -> None:
    assert from_toml(to_toml(calibration).encode()) == calibration


def test_every_file_that_was_cut_off_is_noticed() -> None:
    text = to_toml(OWN)
    assert from_toml(text.encode()) == OWN
    for end in range(len(text) - 1):  # the last character is the end of the line
        with pytest.raises(ValueError, match=r"."):
            from_toml(text[:end].encode())


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("trim_deg = 7.5", "trim_deg = 100", "servos.32.trim_deg: Input should be less than or equal to 90"),
        ("trim_deg = 7.5\n", "", "servos.32 is not whole; a whole calibration names every servo"),
        ("[servos.32]", "[servos.34]", "servos.34: Input should be '11', '12',"),
        ("\n[servos.63]", "\n[landing.63]", "landing.63: Input should be a valid number"),
        ("31 = 90.0", "31 = 150.0\n[servos.31]\nmax_deg = 140.0", "is not TOML: Cannot declare ('servos', '31')"),
        ("32 = 45.25", "32 = 150", "the landing pose cannot be reached: servo 32 is calibrated to go from 0 to 140"),
        ("version = 1", "version = 2", "version is 2; this gateway reads 1"),
        ("revision = 3\n\n[landing]", "revision = 4\n\n[landing]", "the last line is not of_revision = 4"),
        ("[landing]", "[colours]", "colours: Extra inputs are not permitted"),
    ],
)
def test_a_broken_file_is_an_error_that_names_the_place(tmp_path: Path, before: str, after: str, fault: str) -> None:
    path = tmp_path / "calibration.toml"
    text = to_toml(OWN)
    assert before in text
    path.write_text(text.replace(before, after))
    with pytest.raises(ConfigError) as raised:
        read(path)
    assert str(raised.value).startswith(f"{path}: {fault}")


def test_the_previous_ten_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    for revision in range(1, 15):
        write(path, RobotCalibration(revision, {32: ServoMapping(revision)}))
    kept = [read(found) for found in previous(path).values()]
    assert [calibration.revision for calibration in kept if calibration] == list(range(13, 13 - EARLIER_KEPT, -1))
    assert read(path) == RobotCalibration(14, {32: ServoMapping(14)})
    path.write_bytes(previous(path)[5].read_bytes())
    assert load(path) == (RobotCalibration(14, {32: ServoMapping(5)}), None), "put back by hand"


# ---- what a gateway starts with


@pytest.mark.parametrize("content", [b"", b"trim = 7\n", b"\xff", b" " * (MAX_CALIBRATION_BYTES + 1), None])
def test_a_file_that_cannot_be_used_is_a_fault_and_the_next_revision_is_newer_than_all(
    tmp_path: Path, content: bytes | None
) -> None:
    path = tmp_path / "calibration.toml"
    for revision in range(1, 16):
        write(path, RobotCalibration(revision))
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    found, fault = load(path)
    assert found == RobotCalibration(15)
    assert str(path) in str(fault)
    write(path, RobotCalibration(16))
    write(path, RobotCalibration(17))
    assert [each.name for each in previous(path).values()][:2] == ["calibration.16.toml", "calibration.14.toml"]


def test_the_folder_that_a_command_reads_without_systemd(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert state_directory("") is None
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/var/lib/other")
    assert state_directory("") == state_to_read("") == tmp_path
    assert state_directory("/mnt/own") == Path("/mnt/own")
