"""A byte is lost, or the machine stalls: the controller is out of sync, and nothing comes back that could say so.

A sample of a minute's faults on the simulated controller; `python -m tests.deaf` tries all of them (docs/deaf.md).
"""

import logging
from collections.abc import Iterator

import pytest

from tests.deaf.faults import Tally, lose_bytes, recorded, stretch_gaps


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """A gateway says of each stop that it stopped, thousands of times here."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def check(tally: Tally) -> None:
    assert tally.stops_after_repeat == [], "each Stop is executed at the latest with its first repeat"
    assert tally.left_on == []
    assert tally.deaf_ms <= 1000, "a stream is synchronised again within resync_ms"
    assert [what for what in tally.unasked if "out of sync" in what] == [], "nothing moves but by half a body"


@pytest.mark.parametrize("tick_phase_ns", [0, 437_000])
def test_a_byte_lost_anywhere(tick_phase_ns: int) -> None:
    tally = lose_bytes(recorded(), every=113, tick_phase_ns=tick_phase_ns)
    assert tally.faults > 500
    assert tally.missed_first_stops > 50, "which the repeats are for"
    assert not tally.dead, "no lost byte kills the firmware"
    assert not tally.corruptions, "nor takes it outside its tables"
    check(tally)


def test_what_a_doubled_byte_does_is_known() -> None:
    """It may push out hundredths of 69 to 99, which are then a length; docs/deaf.md has the figures."""
    tally = lose_bytes(recorded(), every=499, doubled=True)
    assert tally.dead.keys() == {"a buffer of 64 overwrote its SPI handle"}, "never of an id"
    assert 0.3 < tally.dead.total() / tally.faults < 0.7


@pytest.mark.parametrize("first", [16, 17])
def test_a_stall_anywhere(first: int) -> None:
    for tally in stretch_gaps(every=167, first=first).values():
        check(tally)
        assert tally.faults > 10
        assert tally.most_missed == 0, "a frame's transfers leave together"
        assert not tally.unasked, "no half of a body is written"
        assert not tally.corruptions
