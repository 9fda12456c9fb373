"""Which test runs when, on which worker of `pytest -n`, and which ones alone: decided here for all of them."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).parents[1]
ORDER: Final = (
    "box",
    "console",
    "hil",
    "attack",
    "zenoh",
    "ros2",
    "net",
    "walking",
    "falls",
    "mutants",
    "unit",
    "fuzz",
)
"""Longest chains first, last what is short."""
ALONE: Final = (
    "net",
    "hil/test_death.py",
    "hil/test_load.py",
    "hil/test_landing.py",
    "attack/test_console_strangers.py",
    "attack/test_console_starved.py",
    "zenoh/test_replay.py",  # where the machine stalls, a setpoint and the Stop behind it are one instant
)
"""What measures time or fills the machine: `make test` runs these last, one at a time."""
ATTENDED: Final = (
    "console",
    "zenoh/test_calibrate.py",
    "zenoh/test_calibrate_terminal.py",
    "zenoh/test_walk_command.py",
    "zenoh/test_button_command.py",
    "zenoh/test_watch_terminal.py",
)
"""Pages and terminals with a person at them, who is slow, but not stalled: two at a time, between the others."""
THOROUGH: Final = (
    "unit/people/test_recordings.py",
    "unit/people/test_recordings_damaged.py",
    "unit/people/test_walking_gait.py",
    "unit/people/test_walking_postures.py",
    "unit/robot/test_slow_failures.py",
    "unit/robot/test_supervisor_machine.py",
)
"""Searches of some seconds, which `make quick` leaves to `make test`."""
APART: Final = ("hil", "fuzz", "zenoh/test_service.py")
"""Tests that share nothing with those beside them, so that each may run on whichever worker is free."""
TOGETHER: Final = ("box", "net", "ros2")
"""Folders that share a machine or a bridge; files of other folders share a gateway."""
SEARCHES: Final = ("fuzz/test_model_check.py",)
"""The model check: minutes of a processor, while the attended, and then those that run alone, leave one idle."""
STAGES: Final = {"alone": ALONE, "attended": ATTENDED, "searches": SEARCHES}
"""By the mark that `make test` asks for: where its tests are."""


def arrange(items: list[pytest.Item]) -> None:
    """Sort the tests, and mark those that run alone."""
    for item in items:
        if _is_among(_file(item.nodeid), ALONE):
            item.add_marker(pytest.mark.alone)
        elif _is_among(_file(item.nodeid), ATTENDED):
            item.add_marker(pytest.mark.attended)
        elif _is_among(_file(item.nodeid), THOROUGH):
            item.add_marker(pytest.mark.thorough)

    def place(item: pytest.Item) -> int:
        folder = _file(item.nodeid).partition("/")[0]
        return ORDER.index(folder) if folder in ORDER else -1

    items.sort(key=place)


def is_elsewhere(path: Path, stage: str) -> bool:
    """Whether a file has no test of this stage; to import it for the sake of its marks would take its time."""
    return stage in STAGES and path.suffix == ".py" and not _is_among(str(path.relative_to(TESTS)), STAGES[stage])


def give_way(process: int) -> None:
    """Let it, and what it starts, leave the processors to whoever else wants one, at once: a nice value only gives them
    more of the time."""
    os.sched_setscheduler(process, os.SCHED_IDLE, os.sched_param(0))


def group(nodeid: str) -> str:
    """What runs on one worker, one after the other."""
    file = _file(nodeid)
    if _is_among(file, APART):
        return nodeid
    return file.partition("/")[0] if _is_among(file, TOGETHER) else file


def _file(nodeid: str) -> str:
    """Its file, from the folder in tests/ on."""
    return nodeid.partition("::")[0].removeprefix("tests/")


def _is_among(file: str, places: Sequence[str]) -> bool:
    return file in places or file.partition("/")[0] in places
