"""Which tests run when, and which on one worker of `pytest -n`, one after the other.

CONTRIBUTING.md explains the tiers. FOLDERS has the marks of whole folders: a tier, or how its tests run.
"""

import importlib
import os
import random
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).parents[1]
FOLDERS: Final[Mapping[str, tuple[str, ...]]] = {
    "box": ("full",),
    "console": ("full", "attended"),
    "hil": ("full",),
    "ros2": ("full",),
    "net": ("full", "alone"),
    "attack": (),
    "zenoh": (),
    "walking": ("nightly",),
    "mutants": ("full",),
    "unit": (),
    "search": ("full",),
}
"""The marks of each folder's tests. The longest chains come first, last what is short."""
TIERS: Final = ("full", "nightly")
RUN: Final = ("alone", "attended", "searches")
APART: Final = ("hil", "search", "zenoh/test_service.py")
"""Tests that share nothing with those beside them, so that each may run on whichever worker is free."""
TOGETHER: Final = ("box", "net", "ros2")
"""Folders that share a machine or a bridge; files of other folders share a gateway."""
SECOND_BOX: Final = ("box/test_package.py", "box/test_check_faults.py", "box/test_pages.py")
"""These prepare a machine of their own, beside the other boxes: one after the other would take twice as long."""
LACKS: Final = {
    "hil": "tests.hil.bed:missing_packages",
    "net": "tests.net.hosts:lacks",
    "systemd": "tests.box.box:lacks",
    "browser": "tests.console.browser:lacks",
    "other_browsers": "tests.console.other_browsers:lacks",
}
"""By a test's mark: the function that knows; imported where such a test runs, since most runs have none of them."""


def arrange(items: list[pytest.Item]) -> None:
    """Sort the tests, and give each the marks of its folder; one that needs root or Debian's packages is `full`."""
    for item in items:
        own = {mark.name for mark in item.iter_markers()}
        if own & LACKS.keys() and own.isdisjoint(TIERS):
            item.add_marker("full")
        for mark in FOLDERS.get(_folder(item.nodeid), ()):
            if mark not in TIERS or own.isdisjoint(TIERS):
                item.add_marker(mark)
    order = list(FOLDERS)
    items.sort(key=lambda item: order.index(_folder(item.nodeid)) if _folder(item.nodeid) in order else -1)


def shuffle(items: list[pytest.Item], seed: int) -> None:
    draw, files = random.Random(seed).random, dict[str, float]()  # noqa: S311
    items.sort(key=lambda item: (files.setdefault(_file(item.nodeid), draw()), draw()))


def is_elsewhere(path: Path, marks: str) -> bool:
    """Return whether a file has no test that this expression of `pytest -m` selects; importing it would take time."""
    if path.suffix != ".py":
        return False
    text = path.read_text(encoding="utf-8")
    folder = FOLDERS.get(str(path.relative_to(TESTS)).partition("/")[0], ())
    whole = re.search(r"^pytestmark = (\[[^]]*\]|.*)$", text, re.MULTILINE)
    of_file = {*folder, *re.findall(r"mark\.(\w+)", whole[1] if whole else "")}
    if any(f"not {tier}" in marks and tier in of_file for tier in TIERS):
        return True
    stage = marks.partition(" ")[0]
    return stage in RUN and stage not in folder and f"mark.{stage}" not in text


def give_way(process: int) -> None:
    """Let it, and what it starts, leave the processors to whoever else wants one, at once: a nice value only gives them
    more of the time. It leads a session, to which Linux would give as much as to a browser's, say (autogroup)."""
    os.sched_setscheduler(process, os.SCHED_IDLE, os.sched_param(0))
    with suppress(OSError):
        Path(f"/proc/{process}/autogroup").write_text("19", encoding="ascii")


def group(nodeid: str) -> str:
    """Return what runs on one worker, one after the other."""
    file = _file(nodeid)
    if _is_among(file, APART):
        return nodeid
    if _is_among(file, SECOND_BOX):
        return "the second box"
    return _folder(nodeid) if _is_among(file, TOGETHER) else file


def _file(nodeid: str) -> str:
    """Return its file, from the folder in tests/ on."""
    return nodeid.partition("::")[0].removeprefix("tests/")


def _folder(nodeid: str) -> str:
    return _file(nodeid).partition("/")[0]


def _is_among(file: str, places: Sequence[str]) -> bool:
    return file in places or file.partition("/")[0] in places


# ---- what this machine lacks for a test


def skip_where_lacking(item: pytest.Item) -> None:
    """Skip a test that needs what is not here."""
    skip_where("; ".join(filter(None, (_lack(mark.name) for mark in item.iter_markers()))))


@cache
def _lack(mark: str) -> str:
    module, _, function = LACKS.get(mark, "").partition(":")
    return str(getattr(importlib.import_module(module), function)()) if module else ""


def skip_where(lack: str) -> None:
    """Skip the test where something is lacking, in this one line; but never in CI, where the test fails."""
    if lack and os.environ.get("CI") == "true":
        pytest.fail(lack, pytrace=False)
    if lack:
        pytest.skip(lack)
