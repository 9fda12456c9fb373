"""What `make test-all` has shown that `make test` does not run: safety/test-all.json, which is committed.

A claim that leans on such a test names the commit at which it last passed. It is red once a file that the test judges
has changed since: safety/case.toml states these (`judges`), and the test's own file is always among them.
"""

import json
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

from tests.case import left
from tests.case.case import ROOT, Case, load
from tests.case.left import Outcome
from tests.support import schedule

RECORD: Final = ROOT / "safety" / "test-all.json"
"""Not below `tests`, so that it does not change the files' mark."""


@dataclass(frozen=True)
class Shown:
    """One test that passed with all its parameters."""

    commit: str
    """The last one below the files that it judged; with a + where files had changed since."""
    files: str
    """The digest of what it judges."""
    times: int
    figures: dict[str, float] = field(default_factory=dict)
    """The least of each that it left."""


def read(path: Path = RECORD) -> dict[str, Shown]:
    """By the test's name; empty where nobody has run `make test-all`."""
    return {test: Shown(**shown) for test, shown in json.loads(path.read_text()).items()} if path.exists() else {}


def digest(test: str, judges: Iterable[str], root: Path = ROOT) -> str:
    """Of the test's own file and of what it judges: files, or folders with all that is in them."""
    return left.digest(root, [test.partition("::")[0], *judges])


def needed(case: Case) -> set[str]:
    """The tests that claims lean on and `make test` leaves out."""
    return {test for test in case.tests() if schedule.is_extended(test)}


def leave(commit: str, path: Path = RECORD) -> None:
    """Record which of them passed in the run that has just ended; the others' records stay as they are."""
    case = load()
    found = read(path)
    for test, outcomes in (left.outcomes() or {}).items():
        if test in needed(case) and all(each.result == "passed" for each in outcomes):
            files = digest(test, case.judges.get(test, ()))
            found[test] = Shown(commit, files, len(outcomes), _least(outcomes))
    path.write_text(json.dumps({test: asdict(found[test]) for test in sorted(found)}, indent=1) + "\n")


def _least(outcomes: Sequence[Outcome]) -> dict[str, float]:
    names = {name for each in outcomes for name in each.figures}
    return {name: min(float(each.figures[name]) for each in outcomes if name in each.figures) for name in sorted(names)}


def commit() -> str:
    """The last one below these files; with a + where files have changed since."""

    def git(*arguments: str) -> str:
        run = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
        return run.stdout.strip()

    return (git("rev-parse", "--short=10", "HEAD") or "unknown") + ("+" if git("status", "--porcelain") else "")
