"""`python -m tests.fuzz TARGET… --runs N`: fuzz, report, and return 1 where something was found."""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fuzz.run import MAX_GROWTH_MB, fuzz
from tests.fuzz.targets import TARGETS


def main() -> int:
    """Parse, run, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="+", choices=sorted(TARGETS))
    parser.add_argument("--runs", type=int, default=1_000_000, help="inputs per target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="a folder for the corpus and for what is found; else thrown away")
    options = parser.parse_args()
    failed = False
    with TemporaryDirectory() as throw_away:
        for target in options.targets:
            report = fuzz(target, options.runs, options.keep or Path(throw_away), seed=options.seed)
            print(report, flush=True)
            failed |= bool(report.finding) or report.growth_mb > MAX_GROWTH_MB
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
