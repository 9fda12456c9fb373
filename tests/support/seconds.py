"""What a run's seconds went into: its ten slowest tests, each folder's seconds, and what was skipped."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

LEFT: Final = Path(__file__).parents[2] / "build" / "tests"
"""Where each stage leaves its JUnit record."""
SLOWEST: Final = 10


@dataclass(frozen=True)
class Outcome:
    """What became of one test, with one set of parameters."""

    name: str
    result: str
    """`passed`, `failed` or `skipped`."""
    seconds: float = 0.0
    why: str = ""
    """Why it was skipped."""


def begin(left: Path = LEFT) -> None:
    """Forget what was left before."""
    left.mkdir(parents=True, exist_ok=True)
    for record in left.glob("*.xml"):
        record.unlink()


def cases(left: Path = LEFT) -> Iterator[tuple[str, Outcome]]:
    """What became of each test (`tests/unit/test_x.py::test_y`) in the last run."""
    for record in sorted(left.glob("*.xml")):
        for case in ElementTree.parse(record).iter("testcase"):
            name = case.get("name", "")
            test = f"{case.get('classname', '').replace('.', '/')}.py::{name.partition('[')[0]}"
            skipped = case.find("skipped")
            why = "" if skipped is None else skipped.get("message", "")
            failed = case.find("failure") is not None or case.find("error") is not None
            result = "failed" if failed else "passed" if skipped is None else "skipped"
            yield test, Outcome(name, result, float(case.get("time", 0)), why)


def report(cases: Iterable[tuple[str, Outcome]], most: Mapping[str, int]) -> str:
    """As text. `most`: what each folder's tests may take in all, in seconds."""
    ran = list(cases)
    slowest = sorted(((each.seconds, f"{test.partition('::')[0]}::{each.name}") for test, each in ran), reverse=True)
    lines = ["", "slowest:", *(f"{seconds:7.1f} s  {test}" for seconds, test in slowest[:SLOWEST])]
    folders: defaultdict[str, float] = defaultdict(float)
    for test, each in ran:
        folders[test.split("/")[1]] += each.seconds
    lines += ["", "folders, in seconds of their tests:"]
    for folder, seconds in sorted(folders.items(), key=lambda found: -found[1]):
        over = f", may take {most[folder]}" if seconds > most.get(folder, seconds) else ""
        lines.append(f"{seconds:7.0f} s  {folder}{over}")
    return "\n".join([*lines, *_skipped(each for _, each in ran)])


def _skipped(outcomes: Iterable[Outcome]) -> list[str]:
    """One line: how many, and what they need."""
    why = Counter(outcome.why for outcome in outcomes if outcome.result == "skipped")
    if not why:
        return []
    needs = "; ".join(f"{count}: {reason}" for reason, count in why.most_common())
    return ["", f"{why.total()} skipped ({needs})"]
