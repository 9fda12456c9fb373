"""Writes calibrations without a pause, is killed, and looks at what it has left: `… killed_writer PATH ROUNDS`.

Ends with 1 where a file that it has called kept is not there, or any file is broken.
"""

import os
import random
import signal
import sys
import time
from pathlib import Path

from gateway.model.calibration import Calibration, ServoCalibration
from gateway.robot.host import calibration_file

LONGEST_S = 0.02
"""In which some ten files are written."""


def write_without_end(path: Path, after: int, told: int) -> None:
    """Keep one revision after the other, and say each once it is kept."""
    for revision in range(after + 1, after + 100_000):
        calibration_file.write(path, Calibration(revision, {11: ServoCalibration(revision % 9000)}))
        os.write(told, f"{revision}\n".encode())


def main(path: Path, rounds: int) -> int:
    """Returns the exit code."""
    chance = random.Random(rounds)  # noqa: S311  (moments, no secrets)
    newest, at_once = 0, 0
    for _ in range(rounds):
        heard, told = os.pipe()
        child = os.fork()
        if not child:
            write_without_end(path, newest, told)
        os.close(told)
        time.sleep(chance.uniform(0, LONGEST_S))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        with open(heard, encoding="ascii") as kept:
            said = [int(line) for line in kept]
        found = calibration_file.read(path)
        revision = 0 if found is None else found.revision
        last = said[-1] if said else newest
        if not last <= revision <= last + 1:
            print(f"{last} was kept, and {revision} is there")
            return 1
        for earlier in calibration_file.previous(path):
            calibration_file.read(earlier)
        at_once += revision == last + 1
        newest = revision
    print(f"{rounds} times killed: {newest} files kept, {at_once} of them before that was said")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
