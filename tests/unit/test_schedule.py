"""Which tests keep together: what shares a machine or a gateway is on one worker; anything else is free."""

from pathlib import Path

from tests.support import schedule

TESTS = Path(__file__).parents[1]


def test_what_is_named_is_there() -> None:
    for place in (*schedule.ORDER, *schedule.ALONE, *schedule.SEARCHES, *schedule.APART, *schedule.TOGETHER):
        assert (TESTS / place).exists(), place


def test_what_is_apart_shares_nothing() -> None:
    """A fixture for a whole file would be made anew on each worker, and for a whole folder, too."""
    for place in schedule.APART:
        path = TESTS / place
        for file in path.glob("*.py") if path.is_dir() else [path]:
            assert 'scope="' not in file.read_text(), file
