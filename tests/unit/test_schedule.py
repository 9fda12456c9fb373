"""Which tests keep together: what shares a machine, a browser or a gateway is on one worker; anything else is free."""

from pathlib import Path

from tests.support import schedule
from tests.support.schedule import group

TESTS = Path(__file__).parents[1]


def test_a_folder_that_shares_a_machine_is_one_group() -> None:
    assert group("tests/box/test_systemd.py::test_killed") == group("tests/box/test_systemd_console.py::test_console")


def test_a_file_is_one_group() -> None:
    inbox = group("tests/zenoh/test_inbox.py::test_a")
    assert group("tests/zenoh/test_inbox.py::test_b[hexapod/leg/1/cmd::x]") == inbox
    assert group("tests/zenoh/test_rings.py::test_a") != inbox


def test_tests_that_share_nothing_are_apart() -> None:
    assert group("tests/hil/test_faults.py::test_a[plain]") != group(
        "tests/hil/test_faults.py::test_a[length-prefixed]"
    )


def test_the_searches_are_waited_for_by_one_worker() -> None:
    file = "tests/fuzz/test_model_check.py"
    assert group(f"{file}::{schedule.SEARCHES}_keeps_every_promise[a]") == schedule.SEARCHES
    assert group(f"{file}::test_it_finds_a_planted_bug[a]") != schedule.SEARCHES
    assert f"def {schedule.SEARCHES}" in (TESTS.parent / file).read_text()


def test_what_is_named_is_there() -> None:
    for place in (*schedule.ORDER, *schedule.ALONE, *schedule.APART, *schedule.TOGETHER):
        assert (TESTS / place).exists(), place


def test_what_is_apart_shares_nothing() -> None:
    """A fixture for a whole file would be made anew on each worker, and for a whole folder, too."""
    for place in schedule.APART:
        path = TESTS / place
        for file in path.glob("*.py") if path.is_dir() else [path]:
            assert 'scope="' not in file.read_text(), file
