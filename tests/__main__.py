"""`python -m tests`: what each commit has to show, in stages (tests/support/schedule.py), for `make test`.

python -m tests            # make test
python -m tests --all      # make test-all: searches and repetitions as well
python -m tests --quick    # make quick: ruff, mypy and the unit tests, at once

Exit code 1: a test failed. One that failed beside others is run once more, alone: on two processors three workers, a
browser and a robot with physics may hold a program up for longer than any patience. It is named as flaky then. What
runs alone has no second chance.

The model check's searches run behind the stages that leave processors idle, and only take these.
"""

import argparse
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Final

import pytest

from tests.support import descendants, schedule, seconds
from tests.support.descendants import Run

MOST_AGAIN: Final = 5
"""Where more have failed, it was not the machine."""
STAGE_S: Final = 2400
"""A stage that takes longer hangs behind its tests, each of which pyproject.toml gives a quarter of an hour."""
TOGETHER: Final = "not alone and not attended and not searches"
_PYTEST: Final = (sys.executable, "-m", "pytest")
_FAILED: Final = Path(".pytest_cache") / "v" / "cache" / "lastfailed"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests", description="All tests, in their stages.")
    parser.add_argument("--workers", type=int, default=3, help="how many run side by side (default: %(default)s)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--all", action="store_true", help="searches and repetitions as well")
    which.add_argument("--quick", action="store_true", help="ruff, mypy and the unit tests")
    chosen = parser.parse_args()
    begun_s = time.monotonic()
    with Run() as run:
        run.pass_on()
        green = _quick() if chosen.quick else _test(chosen.workers, everything=chosen.all)
    if not chosen.quick:
        print(seconds.report(seconds.cases(), schedule.SECONDS if not chosen.all else {}))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{time.monotonic() - begun_s:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of processors")
    return 0 if green else 1


def _quick() -> bool:
    with _behind(["make", "--no-print-directory", "check"]) as check:
        unit = subprocess.run([*_PYTEST, "-q", "-n", "2", "-m", "not thorough", "tests/unit"], check=False)
    return unit.returncode == check.returncode == 0


def _test(workers: int, *, everything: bool) -> bool:
    seconds.begin()
    only = "" if everything else " and not extended"
    beside = [_stage("together", "--cache-clear", "-n", str(workers), "-m", TOGETHER + only)]
    search = _command("searches", "-n", "auto", "-p", "no:cacheprovider", "-m", "searches")
    with _behind(search, idle=True) if everything else nullcontext() as searches:
        beside.append(_stage("attended", "-n", "2", "-m", f"attended{only}"))
        green = all(beside)
        flaky: list[str] = []
        if not green and len(failed := _failed()) <= MOST_AGAIN and _stage("again", "--last-failed"):
            green, flaky = True, failed
        green = _stage("alone", "-m", f"alone{only}") and green
    if searches:
        green = searches.returncode == pytest.ExitCode.OK and green
    for test in flaky:
        print(f"FLAKY: {test} failed beside others and passed alone")
    return green


def _stage(name: str, *arguments: str) -> bool:
    """Whether all its tests have passed; ends this program where they could not be run to their end."""
    begun_s = time.monotonic()
    process = subprocess.Popen(_command(name, *arguments), process_group=0)
    try:
        code = process.wait(STAGE_S)
    except subprocess.TimeoutExpired:
        for pid in (process.pid, *descendants.children(process.pid)):
            descendants.send(pid, signal.SIGABRT)  # at which pytest says where it stands
        process.wait()
        sys.exit(f"stage {name} has not ended after {STAGE_S} s")
    print(f"stage {name}: {time.monotonic() - begun_s:.0f} s", flush=True)
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        sys.exit(code)
    return code == pytest.ExitCode.OK


@contextmanager
def _behind(command: list[str], *, idle: bool = False) -> Iterator[subprocess.Popen[bytes]]:
    """A program that runs meanwhile and is waited for at the end; `idle`: only where a processor is idle.

    What it prints comes behind the others' output.
    """
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, process_group=0)
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


def _command(name: str, *arguments: str) -> list[str]:
    return [*_PYTEST, *arguments, f"--junitxml={seconds.LEFT / name}.xml"]


def _failed() -> list[str]:
    return list(json.loads(_FAILED.read_text()))


if __name__ == "__main__":
    sys.exit(main())
