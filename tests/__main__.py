"""`python -m tests`: all tests in their stages (tests/support/schedule.py), for `make test`. Exit code 1: one failed.

A test that failed beside others is judged once more, alone: on two processors three workers, a browser and a robot with
physics may hold a program up for longer than any patience. It is named as flaky then, and its failure stays on record:
a claim of the safety case that leans on it is red until it passes the first time. What runs alone has no second chance.

The model check's searches run behind the stages that leave processors idle, and only take these.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from tests.case import left
from tests.support import schedule

MOST_AGAIN: Final = 5
"""Where more have failed, it was not the machine."""
TOGETHER: Final = "not alone and not attended and not searches"
_FAILED: Final = Path(".pytest_cache") / "v" / "cache" / "lastfailed"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests", description="All tests, in their stages.")
    parser.add_argument("--workers", type=int, default=3, help="how many run side by side (default: %(default)s)")
    workers: int = parser.parse_args().workers
    signal.signal(signal.SIGINT, lambda *_: None)  # pytest ends in its own time, and this behind it
    left.begin()
    beside = [_stage("together", "--cache-clear", "-n", str(workers), "-m", TOGETHER)]
    with _behind("searches", "-n", "auto", "-p", "no:cacheprovider", "-m", "searches") as searches:
        beside.append(_stage("attended", "-n", "2", "-m", "attended"))
        green = all(beside)
        flaky: list[str] = []
        if not green and len(failed := _failed()) <= MOST_AGAIN and _stage("again", "--last-failed"):
            green, flaky = True, failed
        green = _stage("alone", "-m", "alone") and green
        green = searches.wait() == pytest.ExitCode.OK and green
    for test in flaky:
        print(f"FLAKY: {test} failed beside others and passed alone")
    return 0 if green else 1


def _stage(name: str, *arguments: str) -> bool:
    """Whether all its tests have passed; ends this program where they could not be run to their end."""
    begun_s = time.monotonic()
    code = subprocess.run(_command(name, *arguments), check=False).returncode
    print(f"stage {name}: {time.monotonic() - begun_s:.0f} s", flush=True)
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        sys.exit(code)
    return code == pytest.ExitCode.OK


@contextmanager
def _behind(name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Tests that run meanwhile, and only where a processor is idle; what they print is printed behind the others'."""
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(_command(name, *arguments), stdout=said, stderr=subprocess.STDOUT)
        try:
            schedule.give_way(process.pid)
            yield process
        finally:
            process.terminate()
            process.wait()
            said.seek(0)
            print(said.read().decode(errors="replace"), flush=True)


def _command(name: str, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "pytest", *arguments, f"--junitxml={left.LEFT / name}.xml"]


def _failed() -> list[str]:
    return list(json.loads(_FAILED.read_text()))


if __name__ == "__main__":
    sys.exit(main())
