"""What `check` says of the calibration: which one it is, or why nothing could be started with it."""

import os
import time
from pathlib import Path

import pytest

from gateway import durable
from gateway.host import directories
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.onboard.check.calibration import kept, landing_pose
from gateway.onboard.check.result import Verdict
from gateway.robot.host import calibration_file
from gateway.robot.host.calibration_file import SLOW_S
from gateway.robot.settings import Settings


def checked(path: Path) -> tuple[Verdict, str, str]:
    result = kept(Settings.model_validate({"state": {"path": str(path.parent)}}))
    return result.verdict, result.sentence, result.fix


def test_which_one_it_is(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    assert checked(path) == (Verdict.OK, f"none: every servo is as drawn ({path})", "")
    calibration_file.write(path, RobotCalibration(3, {11: ServoMapping(5_00)}))
    assert checked(path) == (Verdict.OK, f"revision 3, 1 servo ({path})", "")


def test_one_that_cannot_be_used_is_a_failure_with_its_fix(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text("trim = 7\n")
    verdict, sentence, fix = checked(path)
    assert verdict is Verdict.FAILURE
    assert sentence == f"{path}: version is None; this gateway reads 1; nothing can be started"
    assert "hexapod-gateway calibrate accept-default" in fix


def test_a_change_that_is_not_on_the_disk_after_seconds_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    calibration_file.write(path, RobotCalibration(3))
    staged = durable.staged_for(path)
    staged.touch()
    assert checked(path)[0] is Verdict.OK, "it may be written just now"
    begun_s = time.time() - SLOW_S - 1
    os.utime(staged, (begun_s, begun_s))
    verdict, sentence, fix = checked(path)
    assert verdict is Verdict.WARNING
    assert "was not kept, and revision 3 is" in sentence
    assert "restart it" in fix
    calibration_file.write(path, RobotCalibration(4))
    assert checked(path)[0] is Verdict.OK


def test_what_only_the_service_may_read_is_no_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, _mode: path != tmp_path)  # root may enter any folder
    verdict, _, fix = checked(tmp_path / "calibration.toml")
    assert (verdict, fix) == (Verdict.WARNING, "sudo hexapod-gateway check")


def test_in_memory_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setattr(directories, "SERVICE_STATE", tmp_path / "none")
    assert "in memory only" in kept(Settings()).sentence


def test_a_landing_pose_that_is_never_sent_is_reported(tmp_path: Path) -> None:
    """By the settings or by the calibration, whose trims count."""
    path = tmp_path / "calibration.toml"
    calibration_file.write(path, RobotCalibration(3, {12: ServoMapping(-3_00)}, {21: 2_50}))
    sections = {
        "state": {"path": str(path.parent)},
        "spi": {"framing": "length-prefixed"},
        "watchdog": {"landing_ms": 500, "landing": {"11": 90, "12": 5, "13": 4}},
    }
    found = list(landing_pose(Settings.model_validate(sections)))
    assert [result.verdict for result in found] == [Verdict.WARNING] * 2
    assert found[0].sentence.startswith("5 degrees of servo 12 are its own 2, with its calibration; ")
    assert found[1].sentence.startswith("2.5 degrees of servo 21; ")
    sections["watchdog"] = {"landing_ms": 0}
    assert not list(landing_pose(Settings.model_validate(sections)))
