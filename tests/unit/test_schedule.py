"""Which tests run when: what every commit shows, and what is left to `make test-all`; which of them keep together."""

import re
from pathlib import Path

import pytest

from tests.support import schedule, seconds
from tests.support.seconds import Outcome

TESTS = Path(__file__).parents[1]


def test_what_is_named_is_there() -> None:
    for place in (*schedule.ORDER, *schedule.ALONE, *schedule.SEARCHES, *schedule.APART, *schedule.TOGETHER):
        assert (TESTS / place).exists(), place


@pytest.mark.parametrize("place", schedule.EXTENDED)
def test_each_test_of_test_all_alone_is_there(place: str) -> None:
    """A parameter that is renamed comes back to every commit."""
    file, _, test = place.partition("::")
    assert (TESTS / file).exists()
    assert not test or f"def {test.partition('[')[0]}(" in (TESTS / file).read_text()


def test_a_place_may_be_a_folder_a_file_a_test_or_one_of_its_parameters() -> None:
    assert schedule.is_extended("tests/falls/test_falls.py::test_any")
    assert schedule.is_extended("tests/zenoh/test_drill.py::test_any[x]")
    assert schedule.is_extended("tests/attack/test_console_strangers.py::test_stop_all_beside_strangers[get-50]")
    assert not schedule.is_extended(
        "tests/attack/test_console_strangers.py::test_stop_all_beside_strangers[garbage-100]"
    )
    assert not schedule.is_extended("tests/attack/test_console_strangers.py::test_stop_all_beside_strangers")


def test_a_file_is_imported_only_where_it_has_tests_that_run() -> None:
    """`pytest -m` would import it, to find that none of its tests is wanted."""
    drill, load, page = (TESTS / file for file in ("zenoh/test_drill.py", "hil/test_load.py", "console/test_page.py"))
    assert schedule.is_elsewhere(drill, "not alone and not extended")
    assert not schedule.is_elsewhere(drill, "not alone")
    assert schedule.is_elsewhere(load, "attended and not extended")
    assert schedule.is_elsewhere(load, "alone and not extended")
    assert not schedule.is_elsewhere(page, "attended and not extended")


def test_the_table_of_seconds_is_that_of_the_runs() -> None:
    page = (TESTS.parent / "CONTRIBUTING.md").read_text()
    rows = re.findall(r"^\| `(\w+)/` \|.*\| (\d+) \|$", page, re.MULTILINE)
    assert {folder: int(seconds) for folder, seconds in rows} == schedule.SECONDS


def test_a_run_says_where_its_time_went_and_what_was_skipped() -> None:
    cases = [
        ("tests/hil/test_a.py::test_b", Outcome("test_b[1]", "passed", seconds=3)),
        ("tests/hil/test_a.py::test_b", Outcome("test_b[2]", "skipped", seconds=0, why="no umockdev")),
        ("tests/unit/test_c.py::test_d", Outcome("test_d", "passed", seconds=2)),
    ]
    assert seconds.report(cases, {"hil": 2, "unit": 5}).splitlines() == [
        "",
        "slowest:",
        "    3.0 s  tests/hil/test_a.py::test_b[1]",
        "    2.0 s  tests/unit/test_c.py::test_d",
        "    0.0 s  tests/hil/test_a.py::test_b[2]",
        "",
        "folders, in seconds of their tests:",
        "      3 s  hil, may take 2",
        "      2 s  unit",
        "",
        "1 skipped (1: no umockdev)",
    ]


def test_what_is_apart_shares_nothing() -> None:
    """A fixture for a whole file would be made anew on each worker, and for a whole folder, too."""
    for place in schedule.APART:
        path = TESTS / place
        for file in path.glob("*.py") if path.is_dir() else [path]:
            assert 'scope="' not in file.read_text(), file
