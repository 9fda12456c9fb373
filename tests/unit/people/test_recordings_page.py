"""docs/recordings.md: its program runs, and its table of channels is complete."""

import json
import re
import runpy
import sys
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.people.recorder.drawing import DRAWN, FRAMES
from gateway.people.recorder.record import REPORTS
from tests.support.mcap_file import checked
from tests.unit.people.test_recordings import recorded

DOCS: Final = Path(__file__).parents[3] / "docs"
PAGE: Final = (DOCS / "recordings.md").read_text()
FILE: Final = PAGE.partition("## What a file contains")[2].partition("An exported incident")[0]


def test_the_pages_program_reads_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ride.mcap"
    recorded(path)
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(program.splitlines()) <= 22
    (tmp_path / "read.py").write_text(program)
    monkeypatch.setattr(sys, "argv", ["read.py", str(path)])
    runpy.run_path(str(tmp_path / "read.py"))
    printed = capsys.readouterr().out
    assert "'watchdog': " in printed
    assert "11: 90.0" in printed


def test_the_viewers_layout_names_only_what_a_recording_has(tmp_path: Path) -> None:
    path = tmp_path / "ride.mcap"
    recorded(path)
    samples: dict[str, Any] = dict(checked(path))
    layout = json.loads((DOCS / "viewers" / "lichtblick.json").read_text())
    panels: dict[str, dict[str, Any]] = layout["configById"]
    assert sorted(_panels(layout["layout"])) == sorted(panels)
    named = 0
    for panel in panels.values():
        topics = [*panel.get("topics", ()), *([panel["topicToRender"]] if "topicToRender" in panel else ())]
        assert set(topics) <= samples.keys()
        for series in panel.get("paths", ()):
            topic, *fields = re.split(r"\.|(?=\[)", series["value"])
            value = samples[topic]
            for field in fields:
                value = value[int(field[1:-1])] if field.startswith("[") else getattr(value, field)
            number = int(series["label"].removeprefix("joint_"))
            assert samples[topic].name[int(fields[-1][1:-1])] == f"joint_{number}", series
        named += len(topics) + len(panel.get("paths", ()))
    assert named == 10
    assert panels["3D!robot"]["followTf"] in {each.child_frame_id for each in samples[FRAMES].transforms}


def _panels(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else [*_panels(node["first"]), *_panels(node["second"])]


def test_the_pages_table_has_every_channel() -> None:
    named = re.findall(r"`(/?[a-z_/]+)`", "".join(re.findall(r"^\| (`.*?) \|", FILE, re.MULTILINE)))
    assert sorted(named) == sorted([*REPORTS, *DRAWN])
