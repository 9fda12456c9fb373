"""What docs/safety.md names exists: tests, scenes of `make kernel`, settings. (Links: test_docs.py.)"""

import ast
import re
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Final

from gateway.robot.settings import Settings
from tests.kernel.inside.scenes import SCENES

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")


@cache
def _marks(text: str) -> dict[str, list[str]]:
    """Return the marks of each of a file's tests."""
    tests = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return {test.name: [ast.unparse(mark) for mark in test.decorator_list] for test in tests}


def always_skipped(text: str, function: str) -> bool | None:
    """Of a test in a file with this text; None: there is no such test."""
    marks = _marks(text).get(function)
    if marks is None:
        return None
    return any(re.search(r"mark\.(skip|xfail)\b", mark) for mark in marks) or bool(
        re.search(r"^pytestmark\b.*\b(skip|xfail)\b|^pytest\.skip\(", text, re.MULTILINE)
    )


def test_each_test_that_it_names_exists_and_is_not_skipped() -> None:
    def text(file: str) -> str:
        path = ROOT / "tests" / file
        return path.read_text(encoding="utf-8") if path.exists() else ""

    named = sorted({tuple(name.split("::")) for name in re.findall(r"`([\w/]+\.py::\w+)`", PAGE)})
    assert named
    assert [f"{file}::{test}" for file, test in named if always_skipped(text(file), test) is not False] == []


def test_each_claim_names_what_shows_it() -> None:
    rows = [row for row in PAGE.partition("\n## The case\n")[2].partition("\n## ")[0].splitlines() if row[:2] == "| "]
    assert len(rows) > len(("hazard", "and one claim"))
    assert [row for row in rows[1:] if len(cells := row.split(" | ")) != len("hctd") or "::" not in cells[2]] == []


def test_each_setting_that_it_names_exists() -> None:
    sections = asdict(Settings())
    named = [each for each in re.findall(r"`([a-z_]+)\.([a-z_]+)\b(?!\()", PAGE) if each[0] in sections]
    assert named
    assert [f"{section}.{name}" for section, name in named if name not in sections[section]] == []


def test_each_kernel_scene_that_it_names_exists() -> None:
    named = [scene for row in re.findall(r"`make kernel`: ([^|<]+)", PAGE) for scene in re.findall(r"`([\w-]+)`", row)]
    assert named
    assert [scene for scene in named if scene not in SCENES] == []
