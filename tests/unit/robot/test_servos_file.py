"""The file that says on this machine whether a servo runs."""

import logging
from pathlib import Path

import pytest

from gateway.robot.host.servos_file import SERVOS_FILE, ServosFile


def test_what_an_earlier_run_has_left_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / SERVOS_FILE).write_text("something longer than the line, from another version\n")
    file = ServosFile(tmp_path)
    file.write(7, any_runs=True)
    assert (tmp_path / SERVOS_FILE).read_text() == f"{7:020d} 1\n"


def test_without_a_folder_it_is_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ServosFile(None).write(1, any_runs=True)
    with caplog.at_level(logging.WARNING):
        ServosFile(tmp_path / "none").write(1, any_runs=True)
    assert "an upgrade cannot see whether a servo runs" in caplog.text
