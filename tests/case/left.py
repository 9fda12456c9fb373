"""What the runs of these very files have left in build/case: JUnit records and figures, each with a mark of the files.

The mark is a digest of what is judged and what judges, not a commit's name: a change that is not committed counts, too,
and a clone without its history has the same.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from tests.case.case import ROOT

LEFT: Final = ROOT / "build" / "case"
BENCH: Final = "bench.json"
AGAIN: Final = "again"
"""The record of tests that failed beside others and were run once more, alone."""
MARK: Final = "files"
_JUDGED: Final = ("gateway", "schemas", "tests", "deploy", "examples", "pyproject.toml")
_MADE: Final = ("__pycache__", ".hypothesis")


def mark(root: Path = ROOT) -> str:
    """The digest of all that tests run and read."""
    return digest(root, _JUDGED)


def digest(root: Path, names: Iterable[str]) -> str:
    """Of these files, and of all files in these folders; one that is gone counts as none."""
    found = sha256()
    for path in sorted({path for name in names for path in _files(root / name)}):
        found.update(f"{path.relative_to(root)}\0{sha256(path.read_bytes()).hexdigest()}\n".encode())
    return found.hexdigest()[:16]


def _files(place: Path) -> Iterator[Path]:
    found = [place] if place.is_file() else place.rglob("*")
    yield from (path for path in found if path.is_file() and not any(made in path.parts for made in _MADE))


@dataclass(frozen=True)
class Outcome:
    """What became of one test, with one set of parameters."""

    name: str
    result: str
    """`passed`, `failed`, `skipped`, or `flaky`: it failed beside others and passed alone."""
    figures: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    why: str = ""
    """Why it was skipped."""


def begin(left: Path = LEFT, root: Path = ROOT) -> None:
    """Forget what was left before, and note for which files the next records count."""
    left.mkdir(parents=True, exist_ok=True)
    for record in left.glob("*.xml"):
        record.unlink()
    (left / MARK).write_text(mark(root) + "\n")


def outcomes(left: Path = LEFT, root: Path = ROOT) -> dict[str, list[Outcome]] | None:
    """Of each test (`tests/unit/test_x.py::test_y`), what became of it; None: nobody ran these files' tests."""
    noted = left / MARK
    if not noted.exists() or noted.read_text().strip() != mark(root):
        return None
    found: dict[str, dict[str, Outcome]] = {}
    for test, outcome in cases(left):
        found.setdefault(test, {})[outcome.name] = outcome
    for test, outcome in _cases(left / f"{AGAIN}.xml"):
        if outcome.result == "passed" and found[test][outcome.name].result == "failed":
            found[test][outcome.name] = replace(outcome, result="flaky")
    return {test: list(outcomes.values()) for test, outcomes in found.items()}


def cases(left: Path = LEFT) -> Iterator[tuple[str, Outcome]]:
    """What became of each test in the last run, the first time."""
    for record in sorted(left.glob("*.xml")):
        if record.stem != AGAIN:
            yield from _cases(record)


def _cases(record: Path) -> Iterator[tuple[str, Outcome]]:
    if not record.exists():
        return
    for case in ElementTree.parse(record).iter("testcase"):
        name = case.get("name", "")
        test = f"{case.get('classname', '').replace('.', '/')}.py::{name.partition('[')[0]}"
        skipped = case.find("skipped")
        why = "" if skipped is None else skipped.get("message", "")
        yield test, Outcome(name, _result(case), _figures(case), float(case.get("time", 0)), why)


def _result(case: ElementTree.Element) -> str:
    if case.find("failure") is not None or case.find("error") is not None:
        return "failed"
    return "passed" if case.find("skipped") is None else "skipped"


def _figures(case: ElementTree.Element) -> dict[str, str]:
    return {each.get("name", ""): each.get("value", "") for each in case.iter("property")}


def leave_bench(rows: Iterable[dict[str, Any]], left: Path = LEFT, root: Path = ROOT) -> None:
    """Keep the benchmark's rows; those of a part that ran earlier for the same files stay."""
    left.mkdir(parents=True, exist_ok=True)
    kept = {row["name"]: row for row in bench(left, root) or ()}
    kept |= {row["name"]: row for row in rows}
    found = {"files": mark(root), "rows": list(kept.values())}
    (left / BENCH).write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n")


def bench(left: Path = LEFT, root: Path = ROOT) -> list[dict[str, Any]] | None:
    """The benchmark's rows for these files; None: it was not run for them."""
    path = left / BENCH
    if not path.exists():
        return None
    found = json.loads(path.read_text())
    rows: list[dict[str, Any]] = found["rows"]
    return rows if found["files"] == mark(root) else None
