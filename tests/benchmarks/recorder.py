"""What the black box costs: two gateways, one with it and one without, at once."""

import os
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from timeit import timeit

from tests.benchmarks.processes import cpu_ns
from tests.benchmarks.subjects import SETTLE_S, Subject
from tests.benchmarks.table import Row, ratio_row
from tests.support.one_record import writers

ROUNDS = 15
ROUND_S = 2.0
MOST_US = 3
MOST = 1.03
"""CPU time with it, as a multiple of that without."""
MEMORY = Path("/dev/shm")  # noqa: S108  where the ring is on a robot, too; the folder in it is made anew


def recorder(folder: Path) -> list[Row]:
    """CPU time of a message, six legs at 50 Hz. In the column of the naive script: a gateway without the black box.

    Both run at once: the machine's speed, which changes within a round, is then the same for both.
    """
    with ExitStack() as stack:
        ring = stack.enter_context(TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else folder))
        os.environ["XDG_RUNTIME_DIR"] = ring
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
            begun_ns = [cpu_ns(subject.pid) for subject in subjects]
            for publisher in publishers if number % 2 else reversed(publishers):
                publisher.start(ROUND_S)
            counts = [publisher.wait() for publisher in publishers]
            time.sleep(SETTLE_S)
            for each, subject, before_ns, count in zip(found, subjects, begun_ns, counts, strict=True):
                each.append((cpu_ns(subject.pid) - before_ns) / count / 1000)
        rows = _records(folder / "records")
    return [
        *rows,
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
