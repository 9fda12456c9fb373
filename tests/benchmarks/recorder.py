"""What the black box costs: two gateways, one with it and one without, in turn."""

import os
from contextlib import ExitStack
from pathlib import Path
from timeit import timeit

from tests.benchmarks.processes import cpu_ns
from tests.benchmarks.subjects import Subject
from tests.benchmarks.table import Row, ratio_row
from tests.support.one_record import writers

ROUNDS = 8
ROUND_S = 2.0
MOST_US = 3
MOST = 1.03
"""CPU time with it, as a multiple of that without."""


def recorder(folder: Path) -> list[Row]:
    """CPU time of a message, six legs at 50 Hz. In the column of the naive script: a gateway without the black box."""
    os.environ["XDG_RUNTIME_DIR"] = str(folder)  # for the ring: what a run leaves goes with its folder
    with ExitStack() as stack:
        subjects = []
        for name in ("with", "without"):
            (folder / name).mkdir()
            settings = {"recorder": {"path": str(folder / name)}} if name == "with" else {}
            subjects.append(Subject("gateway", folder / name, stack, settings))
        publishers = [subject.publisher("--legs", *"123456", "--hz", "50", "--shape", "apart") for subject in subjects]
        for publisher in publishers:
            publisher.run(0.5)
        found: tuple[list[float], list[float]] = ([], [])
        for number in range(ROUNDS):
            for index in (0, 1) if number % 2 else (1, 0):
                begun_ns = cpu_ns(subjects[index].pid)
                count = publishers[index].run(ROUND_S)
                found[index].append((cpu_ns(subjects[index].pid) - begun_ns) / count / 1000)
    return [
        *_records(folder / "records"),
        ratio_row("black box, six legs, 50 Hz: CPU time a message, beside a gateway without it", *found, "µs", MOST),
    ]


def _records(folder: Path) -> list[Row]:
    """What one record takes, in a loop; the best of some rounds, since others take their share of the rest."""
    folder.mkdir()
    rows = []
    for name, write in writers(folder).items():
        best_us = min(timeit(write, number=500) for _ in range(20)) * 2000
        rows.append(
            Row(
                f"black box: a record of a {name}", f"{best_us:.1f} µs", "", f"at most {MOST_US} µs", best_us <= MOST_US
            )
        )
    return rows
