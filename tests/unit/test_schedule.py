"""Which tests keep together: what shares a machine or a gateway is on one worker; anything else is free."""

from pathlib import Path

from tests.support import schedule
from tests.support.schedule import group

TESTS = Path(__file__).parents[1]


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
