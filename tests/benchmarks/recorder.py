"""What the black box costs: two gateways, one with it and one without, at once."""

import os
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from timeit import timeit

from tests.benchmarks.beside import measure, started
from tests.benchmarks.table import Row, ratio_row
from tests.support.one_record import writers

MOST_US = 3
MOST = 1.03
"""CPU time with it, as a multiple of that without."""
MEMORY = Path("/dev/shm")  # noqa: S108  where the ring is on a robot, too; the folder in it is made anew


def recorder(folder: Path) -> list[Row]:
    """CPU time of a message, six legs at 50 Hz. In the column of the naive script: a gateway without the black box."""
    with ExitStack() as stack:
        ring = stack.enter_context(TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else folder))
        os.environ["XDG_RUNTIME_DIR"] = ring
        sides = started(folder, stack, {"state": {"path": str(folder / "with")}})
        measure(sides)
        rows = _records(folder / "records")
    return [
        *rows,
        ratio_row(
            "black box, six legs, 50 Hz: CPU time a message, beside a gateway without it",
            sides[0].cpu_us,
            sides[1].cpu_us,
            "µs",
            MOST,
        ),
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
