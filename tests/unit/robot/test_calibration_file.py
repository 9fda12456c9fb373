"""The calibration on disk: what is written is read again, and what is broken in any way is an error."""

from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.host.directories import state_to_read
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.robot.host import calibration_file
from gateway.robot.host.calibration_file import (
    EARLIER_KEPT,
    from_toml,
    load,
    path_of,
    previous,
    read,
    to_toml,
    write,
)
from gateway.robot.settings import Settings

OWN = RobotCalibration(3, {32: ServoMapping(7_50, inverted=True, max_cdeg=140_00)}, {31: 90_00, 32: 45_25})


def test_every_file_that_was_cut_off_is_noticed() -> None:
    text = to_toml(OWN)
    for end in range(len(text) - 1):  # the last character is the end of the line
        with pytest.raises(ValueError, match=r"."):
            from_toml(text[:end].encode())


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("trim_deg = 7.5", "trim_deg = 400", "servos.32.trim_deg: 400 is not allowed: input should be less than"),
        ("trim_deg = 7.5", "trim_deg = 100", "servo 32: trim_deg is 100; it is -90 to 90"),
        ("trim_deg = 7.5\n", "", "servos.32.trim_deg: is missing; a whole calibration names every servo"),
        ("[servos.32]", "[servos.34]", "servos has no 32; a whole calibration names every servo"),
        ("31 = 90.0", "70 = 90.0", "servo 70 does not exist"),
        ("version = 1", "version = 2", "version is 2; this gateway reads 1"),
        ("[landing]", "[colours]", "landing: is missing"),
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


@pytest.mark.parametrize(
    "content", [b"\xff\xfe", b"\0" * 100, b"[" * 5000, b" " * (calibration_file.MAX_CALIBRATION_BYTES + 1)]
)
def test_a_foreign_file_is_an_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "calibration.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError):
        read(path)


def test_the_previous_ten_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "state" / "calibration.toml"
    for revision in range(1, 15):
        write(path, RobotCalibration(revision, {32: ServoMapping(revision)}))
    kept = [read(found) for found in previous(path)]
    assert [calibration.revision for calibration in kept if calibration] == list(range(13, 13 - EARLIER_KEPT, -1))
    assert read(path) == RobotCalibration(14, {32: ServoMapping(14)})


# ---- what a gateway starts with


@pytest.mark.parametrize("text", ["", "trim = 7\n", "\0" * 2000, to_toml(OWN)[:-30], None])
def test_a_file_that_cannot_be_used_is_a_fault_and_the_next_revision_is_newer_than_all(
    tmp_path: Path, text: str | None
) -> None:
    path = tmp_path / "calibration.toml"
    for revision in range(1, 16):
        write(path, RobotCalibration(revision))
    path.unlink()
    if text is not None:
        path.write_text(text)
    found, fault = load(path)
    assert found == RobotCalibration(15)
    assert str(path) in str(fault)
    write(path, RobotCalibration(16))
    write(path, RobotCalibration(17))
    assert [each.name for each in previous(path)][:2] == ["calibration.16.toml", "calibration.14.toml"]


# ---- where it is


def test_where_it_is_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    named = Settings.of({"state": {"path": "/mnt/own"}})
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert path_of(Settings()) is None
    assert path_of(named) == Path("/mnt/own/calibration.toml")
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/var/lib/other")
    assert path_of(Settings()) == path_of(Settings(), state_to_read) == tmp_path / "calibration.toml"
    assert path_of(named) == Path("/mnt/own/calibration.toml")
