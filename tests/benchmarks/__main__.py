"""The benchmark: this gateway and the naive script at once, on devices that answer at once (duel.py).

python -m tests.benchmarks [--quick] [--release FOLDER]
"""

import argparse
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks.duel import as_text, duel


def machine() -> str:
    """The machine in words."""
    cpu = next(
        (line.partition(": ")[2] for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.machine(),
    )
    return (
        f"{os.cpu_count()} × {cpu}, Linux {platform.release()}, Python {platform.python_version()},"
        f" load before the run {os.getloadavg()[0]:.1f}"
    )


def main() -> int:
    """Compare them. The exit status is 0 whatever the figures, for a benchmark is no test."""
    parser = argparse.ArgumentParser(description="Measure the gateway beside a naive script.")
    parser.add_argument("--quick", action="store_true", help="only the two streams that matter most")
    parser.add_argument("--release", type=Path, metavar="FOLDER", help="compare with this tree's gateway, too")
    options = parser.parse_args()
    where, begun_s = machine(), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        print(as_text(duel(Path(folder), short=options.quick, release=options.release)))
    print(
        f"\n{where}; the run took {time.monotonic() - begun_s:.0f} s;"
        " ratios are medians over the slices (least to most)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
