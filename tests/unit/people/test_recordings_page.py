"""docs/recordings.md: its program runs, and its table of channels is complete."""

import re
import runpy
import sys
from pathlib import Path
from typing import Final

import pytest

from gateway.people.recordings import REPORTS
from gateway.people.recordings.drawing import DRAWN
from tests.unit.people.test_recordings import recorded

PAGE: Final = (Path(__file__).parents[3] / "docs" / "recordings.md").read_text()


def test_the_pages_program_reads_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ride.mcap"
    recorded(path).close()
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(program.splitlines()) <= 22
    (tmp_path / "read.py").write_text(program)
    monkeypatch.setattr(sys, "argv", ["read.py", str(path)])
    runpy.run_path(str(tmp_path / "read.py"))
    printed = capsys.readouterr().out
    assert "'watchdog': " in printed
    assert "11: 90.0" in printed


def test_the_pages_table_has_every_channel() -> None:
    named = re.findall(r"`(/?[a-z_/]+)`", "".join(re.findall(r"^\| (`.*?) \|", PAGE, re.MULTILINE)))
    assert sorted(named) == sorted([*REPORTS, *DRAWN])
