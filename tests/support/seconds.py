"""What a run's seconds went into: its ten slowest tests, each folder's seconds, and what was skipped; for pytest."""

from collections import Counter, defaultdict
from collections.abc import Iterable

import pytest

SLOWEST = 10


def report(cases: Iterable[pytest.TestReport]) -> list[str]:
    """As lines, of what became of each test: its setup, its call and its teardown."""
    tests: defaultdict[str, float] = defaultdict(float)
    folders: defaultdict[str, float] = defaultdict(float)
    skipped: Counter[str] = Counter()
    for case in cases:
        tests[case.nodeid] += case.duration
        folders[case.nodeid.split("/")[1]] += case.duration
        if case.skipped and isinstance(case.longrepr, tuple):
            skipped[case.longrepr[2].removeprefix("Skipped: ")] += 1
    slowest = sorted(((seconds, test) for test, seconds in tests.items()), reverse=True)[:SLOWEST]
    of_folders = sorted(folders.items(), key=lambda found: -found[1])
    needs = "; ".join(f"{count}: {reason}" for reason, count in skipped.most_common())
    return [
        "slowest:",
        *(f"{seconds:7.1f} s  {test}" for seconds, test in slowest),
        f"seconds of tests: {', '.join(f'{folder} {seconds:.0f}' for folder, seconds in of_folders)}",
        *([f"{skipped.total()} skipped ({needs})"] if skipped else []),
    ]
