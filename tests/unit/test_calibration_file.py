"""The calibration on disk: what is written is read again, and what is broken in any way is an error."""

import errno
import os
from pathlib import Path

import pytest
from hypothesis import given

from gateway.core.calibration import Calibration, ServoCalibration
from gateway.errors import ConfigError
from gateway.host import calibration_file
from gateway.host.calibration_file import KEPT, from_toml, previous, read, to_toml, write
from tests.unit.test_calibration import calibrations

OWN = Calibration(3, {32: ServoCalibration(7_50, inverted=True, max_cdeg=140_00)}, {31: 90_00, 32: 45_25})


@given(calibrations)
def test_what_is_written_is_read(calibration: Calibration) -> None:
    assert from_toml(to_toml(calibration)) == calibration


def test_every_file_that_was_cut_off_is_noticed() -> None:
    text = to_toml(OWN)
    for end in range(len(text) - 1):  # the last character is the end of the line
        with pytest.raises(ValueError, match=r"."):
            from_toml(text[:end])


def test_there_is_none_yet(tmp_path: Path) -> None:
    assert read(tmp_path / "calibration.toml") is None


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("trim_deg = 7.5", "trim_deg = 400", "servos.32.trim_deg is 400; that is more than a turn"),
        ("trim_deg = 7.5", "trim_deg = 100", "servo 32: trim_deg is 100; it is -90 to 90"),
        ("trim_deg = 7.5", "trim_deg = nan", "servos.32.trim_deg is nan; it is a number of degrees"),
        ("trim_deg = 7.5", "trim_deg = true", "servos.32.trim_deg is True; it is a number of degrees"),
        ("trim_deg = 7.5\n", "", "servos.32 has no trim_deg; a whole calibration names every servo"),
        ("inverted = true", 'inverted = "yes"', "servos.32.inverted is 'yes'; it is true or false"),
        ("[servos.32]", "[servos.34]", "servos has no 32; a whole calibration names every servo"),
        ("31 = 90.0", "70 = 90.0", "servo 70 does not exist"),
        ("version = 1", "version = 2", "version is 2; this gateway reads 1"),
        ("version = 1", "speed = 2", "version is None; this gateway reads 1"),
        ("[landing]", "[colours]", "the file has no landing"),
        ("revision = 3\n\n[landing]", "revision = -3\n\n[landing]", "revision is -3; it is a whole number"),
        ("revision = 3\n\n[landing]", "revision = 4\n\n[landing]", "the last line is not of_revision = 4"),
        ("[landing]", "[landing", "is not TOML"),
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


@pytest.mark.parametrize("content", [b"\xff\xfe", b"\0" * 100, b"[" * 5000, b" " * (calibration_file.MAX_BYTES + 1)])
def test_a_foreign_file_is_an_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "calibration.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError):
        read(path)


def test_the_previous_ten_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "state" / "calibration.toml"
    for revision in range(1, 15):
        write(path, Calibration(revision, {32: ServoCalibration(revision)}))
    kept = [read(found) for found in previous(path)]
    assert [calibration.revision for calibration in kept if calibration] == list(range(13, 13 - KEPT, -1))
    assert read(path) == Calibration(14, {32: ServoCalibration(14)})


def test_a_broken_one_is_set_aside(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text("half a")
    write(path, OWN)
    assert read(path) == OWN
    assert (tmp_path / "calibration.broken.toml").read_text() == "half a"


@pytest.mark.parametrize("broken_call", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken_call: str) -> None:
    path = tmp_path / "calibration.toml"
    write(path, OWN)

    def no_space(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", no_space) if broken_call == "fsync" else monkeypatch.setattr(
        Path, "replace", no_space
    )
    with pytest.raises(ConfigError, match=r"No space left on device.*the old calibration stays"):
        write(path, Calibration(4))
    monkeypatch.undo()
    assert read(path) == OWN
    assert not list(tmp_path.glob(".*"))
