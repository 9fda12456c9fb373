"""`make walk`: every gait, direction and assumption; a table. Exit code 1: one is off."""

import itertools
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import Final

from gateway.geometry import MAX_SPEED_DEG_S
from gateway.model.power_board import NO_LOAD_DEG_S
from gateway.people.walking import Velocity
from tests.walking.fast import LIMITS, reached
from tests.walking.judge import judge, table
from tests.walking.physics import VARIATIONS
from tests.walking.recorded import Leg, directions, record
from tests.walking.uneven import COURSES, SENSORS, row, walk

SECONDS: Final = 10.0
SPEEDS_M_S: Final = {"tripod": 0.08, "ripple": 0.04, "wave": 0.02}
"""Two thirds of what each gait's strides reach."""
TURNS_RAD_S: Final = {"tripod": 0.25, "ripple": 0.12, "wave": 0.06}


def course(gait: str, seconds: float = SECONDS) -> list[Leg]:
    """Every 45 degrees, both turns and a curve."""
    speed, turn = SPEEDS_M_S[gait], TURNS_RAD_S[gait]
    return [
        *directions(speed, seconds),
        Leg("turn left", Velocity(0, 0, turn), seconds),
        Leg("turn right", Velocity(0, 0, -turn), seconds),
        Leg("curve", Velocity(speed / 2, 0, turn / 2), seconds),
        Leg("curve back", Velocity(-speed / 2, 0, turn / 2), seconds),
    ]


def uneven(name: str) -> str:
    """One course: blind, by sensors, and by faulty ones."""
    course = COURSES[name]
    faulty = [walk(course, adapts=True, sensor=make()) for make in SENSORS.values()]
    return row(name, [walk(course, adapts=False), walk(course, adapts=True), *faulty])


def fast(gait: str) -> str:
    """A gait, with servos of the usual limit and of their own speed."""
    both = [(speed, reached(gait, speed)) for speed in (MAX_SPEED_DEG_S, NO_LOAD_DEG_S)]
    return f"{gait:8}" + "".join(
        f"  at {speed:.0f}°/s {100 * it.forward:3.0f} % {100 * it.turn:3.0f} %" for speed, it in both
    )


def main() -> int:
    recordings = [record(gait, course(gait)) for gait in SPEEDS_M_S]
    print(f"{len(VARIATIONS)} worlds walk by them: {'; '.join(map(str, VARIATIONS))} …")
    jobs = list(itertools.product(recordings, VARIATIONS))
    with ProcessPoolExecutor() as processes:
        verdicts = list(processes.map(judge, *zip(*jobs, strict=True)))
    print(table([result for verdict in verdicts for result in verdict.results]))
    print("\nuneven ground, way and tilt (mean/worst): blind, by sensors, one stuck on, one stuck off, all late")
    with ProcessPoolExecutor() as processes:
        print("\n".join(processes.map(uneven, COURSES)))
    print("\nboth of the Elkapod's limits at once, in physics: forward and turn, of what was commanded")
    with ProcessPoolExecutor() as processes:
        print("\n".join(processes.map(fast, LIMITS)))
    faults = [fault for verdict in verdicts for fault in verdict.faults]
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
