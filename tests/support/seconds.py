"""What a run's seconds went into: its ten slowest tests, each folder's seconds, and what was skipped."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from typing import Final

from tests.case.left import Outcome

SLOWEST: Final = 10


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
