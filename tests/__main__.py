"""`python -m tests`: the tests in their tiers and stages (tests/support/schedule.py).

python -m tests            # make test: what needs Python and a shell
python -m tests --all      # make test-all: and what needs root or Debian's packages, or searches
python -m tests --rest     # make test-all REST=yes: of these, what make test leaves
python -m tests --nightly  # the tests of make nightly: all of them
python -m tests --quick    # make quick: ruff, mypy and the unit tests, at once

Exit code 1: a test failed. One that failed is run once more, behind all others: on two processors three workers, a
browser and a robot with physics may hold a program up for longer than any patience. It is named as flaky then.

The model check's searches, and mutants of the files that have changed, run behind the stages that leave processors
idle, and only take these. A night also runs each file by itself, and all files in random order: a test may need what
another file's import, or another test, leaves.
"""

import argparse
import json
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from tests.support import runs, schedule
from tests.support.runs import Run

MOST_AGAIN: Final = 5
"""Where more have failed, it was not the machine."""
MOST_S: Final = {"test": 900, "all": 1800, "nightly": 4 * 3600}
"""A run that takes longer ends with the stacks of what hangs: five times what a tier may take, since CI may be slow."""
SAMPLE: Final = 30
"""Of each changed file, so many mutants; `make nightly` judges all of all files."""
MUTANTS_S: Final = 240
"""No mutants of a further file are tried after this time; those of the current file are finished."""
TOGETHER: Final = "not alone and not attended and not searches"
_PYTEST: Final = (sys.executable, "-m", "pytest", "--durations=10")
_FAILED: Final = Path(".pytest_cache") / "v" / "cache" / "lastfailed"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests", description="The tests of a tier, in their stages.")
    parser.add_argument("--workers", type=int, default=3, help="how many run side by side (default: %(default)s)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--all", action="store_true", help="what needs root or Debian's packages, or searches, too")
    which.add_argument("--rest", action="store_true", help="only what a run without options leaves of --all")
    which.add_argument("--nightly", action="store_true", help="what takes long, too")
    which.add_argument("--quick", action="store_true", help="ruff, mypy and the unit tests")
    chosen = parser.parse_args()
    begun_s = time.monotonic()
    with Run() as run, runs.listed():
        run.pass_on()
        if chosen.quick:
            green = _quick()
        elif chosen.nightly:
            stages = Stages(MOST_S["nightly"])
            green = all([_stages(stages, chosen.workers, ""), _shuffled(stages, chosen.workers), _files()])
        elif chosen.all or chosen.rest:
            only = " and not nightly and full" if chosen.rest else " and not nightly"
            green = _stages(Stages(MOST_S["all"]), chosen.workers, only)
        else:
            stages = Stages(MOST_S["test"])
            test = ("--cache-clear", "-n", str(chosen.workers), "-m", "not full and not nightly")
            green = stages.twice([stages.run("test", *test)])
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{time.monotonic() - begun_s:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of processors")
    return 0 if green else 1


def _quick() -> bool:
    with _behind(["make", "--no-print-directory", "check"]) as check:
        options = ("-q", "-n", "2", "-m", "not full and not nightly and not lengthy", "--hypothesis-profile=quick")
        unit = subprocess.run([*_PYTEST, *options, "tests/unit"], check=False)
    return unit.returncode == check.returncode == 0


class Stages:
    """Runs of pytest one after the other, which have so many seconds in all."""

    def __init__(self, most_s: float) -> None:
        self._until_s = time.monotonic() + most_s

    def run(self, name: str, *arguments: str) -> bool:
        """Return whether all its tests passed. Ends this program if they could not be run to their end."""
        begun_s = time.monotonic()
        process = subprocess.Popen([*_PYTEST, *arguments], process_group=0)
        code = self.ended(process, f"stage {name}")
        print(f"stage {name}: {time.monotonic() - begun_s:.0f} s", flush=True)
        if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
            sys.exit(code)
        return code == pytest.ExitCode.OK

    def ended(self, process: subprocess.Popen[bytes], name: str) -> int:
        """Wait for a process, and return its exit code. Ends this program if no time is left."""
        try:
            return process.wait(max(0.0, self._until_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            for pid in (process.pid, *runs.children(process.pid)):
                runs.send(pid, signal.SIGABRT)  # at which pytest says where it stands
            process.wait()
            sys.exit(f"{name} had no time left")

    def twice(self, green: list[bool]) -> bool:
        """Return whether these stages were green, or what failed in them passes alone."""
        if all(green):
            return True
        failed = list(json.loads(_FAILED.read_text()))
        if len(failed) > MOST_AGAIN or not self.run("again", "--last-failed"):
            return False
        for test in failed:
            print(f"FLAKY: {test} failed once and passed alone")
        return True


def _stages(stages: Stages, workers: int, only: str) -> bool:
    green = [stages.run("together", "--cache-clear", "-n", str(workers), "-m", TOGETHER + only)]
    search = [*_PYTEST, "-n", "auto", "-p", "no:cacheprovider", "-m", f"searches{only}"]
    mutants = [sys.executable, "-m", "tests.mutants", "--changed", "--sample", str(SAMPLE), "--seconds", str(MUTANTS_S)]
    with _behind(search, idle=True) as searches, _behind(mutants, idle=True) as judged:
        green.append(stages.run("attended", "-n", "2", "-m", f"attended{only}"))
        green.append(stages.run("alone", "-m", f"alone{only}"))
        passed = stages.twice(green)
        codes = stages.ended(searches, "the searches"), stages.ended(judged, "the mutants")
    return passed and not any(codes)


def _shuffled(stages: Stages, workers: int) -> bool:
    """Return whether all tests pass in an order that no run had before; none has a second try."""
    seed = random.randrange(10**6)  # noqa: S311
    return stages.run(
        f"--shuffle {seed}", "--shuffle", str(seed), "-n", str(workers), "-m", f"{TOGETHER} and not nightly"
    )


def _files() -> bool:
    """Return whether each file of tests passes by itself."""

    def passes(path: Path) -> bool:
        command = [*_PYTEST, "-q", "-p", "no:cacheprovider", "-m", "not alone and not nightly", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            print(f"by itself {path} fails:\n{done.stdout[-4000:]}", flush=True)
            return False
        return True

    files = sorted(schedule.TESTS.rglob("test_*.py"))
    with ThreadPoolExecutor(2) as pool:
        failed = len(files) - sum(pool.map(passes, files))
    print(f"{len(files)} files by themselves, {failed} failed", flush=True)
    return failed == 0


@contextmanager
def _behind(command: list[str], *, idle: bool = False) -> Iterator[subprocess.Popen[bytes]]:
    """Yield a program that runs meanwhile and is waited for at the end; `idle`: only where a processor is idle.

    What it prints comes behind the others' output.
    """
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            if idle:
                schedule.give_way(process.pid)
            yield process
            process.wait()
        finally:
            process.terminate()
            process.wait()
            output.seek(0)
            print(output.read().decode(errors="replace"), flush=True)


if __name__ == "__main__":
    sys.exit(main())
