"""A byte is lost, or the machine stalls: the controller is out of sync, and nothing comes back that could say so.

A sample of a minute's faults on the simulated controller; `python -m tests.deaf` tries all of them (docs/protocol.md).
"""

import logging
from collections.abc import Iterator

import pytest

from tests.deaf.faults import (
    STOPS_MS,
    STOPS_NS,
    BoundedController,
    Tally,
    lose_bytes,
    lose_in_stops,
    lose_transfers,
    recorded,
    stretch_gaps,
)


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """A gateway says of each stop that it stopped, thousands of times here."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def check(tally: Tally) -> None:
    assert tally.stops_after_repeat == [], "each Stop is executed at the latest with its first repeat"
    assert tally.left_on == []
    assert tally.deaf_ms <= 1000, "a stream is synchronised again within a second"
    assert [what for what in tally.unasked if "out of sync" in what] == [], "nothing moves but by half a body"


@pytest.mark.parametrize("tick_phase_ns", [0, 437_000])
def test_a_byte_lost_anywhere(tick_phase_ns: int) -> None:
    tally = lose_bytes(recorded(), every=113, tick_phase_ns=tick_phase_ns)
    assert tally.faults > 500
    assert tally.missed_first_stops > 50, "which the repeats are for"
    assert not tally.dead, "no lost byte kills the firmware"
    assert not tally.corruptions, "nor takes it outside its tables"
    check(tally)


def test_an_announcement_or_a_zero_lost_costs_no_controller_and_a_body_does() -> None:
    tallies = lose_transfers(recorded(), every=41)
    assert tallies.keys() == {"a zero", "an announcement", "a body"}
    assert all(tally.faults > 90 for tally in tallies.values())
    assert tallies["a zero"].without_effect == tallies["a zero"].faults
    for kind in ("a zero", "an announcement"):
        check(tallies[kind])
        assert not tallies[kind].dead
        assert tallies[kind].on_for_good == 0
    assert tallies["a body"].dead.total() > 0.1 * tallies["a body"].faults


@pytest.mark.nightly
@pytest.mark.parametrize("run", [1, 2, 3, 5, 9, 14, 20, 39, 100])
def test_no_bytes_lost_inside_stops_leave_a_servo_on(run: int) -> None:
    """Of the first Stops, of their repeats, and of the runs behind them."""
    first, behind = lose_in_stops(run, stops_ms=STOPS_MS[:1])
    assert first.faults == 408
    assert behind.faults == 3 * 106 + 142
    for tally in (first, behind):
        assert not tally.dead
        assert tally.on_for_good == 0


def test_without_the_runs_behind_them_they_would() -> None:
    """Five lost bytes make a Stop of leg 4 a start of servo 21."""
    first, _ = lose_in_stops(5, stops_ms=STOPS_MS[:1], end_ns=STOPS_NS)
    assert first.left_on_alive > 0.15 * first.faults
    assert not first.dead


@pytest.mark.parametrize("run", [2, 3, 5, 14])
def test_a_firmware_that_rejects_other_lengths_than_6_and_14_survives_them(run: int) -> None:
    """The check that docs/protocol.md proposes to the firmware's owners."""
    tally = lose_bytes(recorded(), every=997, run=run, controller=BoundedController)
    assert tally.faults > 60
    assert not tally.dead
    assert tally.on_for_good == 0


@pytest.mark.parametrize("first", [16, 17])
def test_a_stall_anywhere(first: int) -> None:
    for tally in stretch_gaps(every=167, first=first).values():
        check(tally)
        assert tally.faults > 10
        assert tally.most_missed == 0, "a frame's transfers leave together"
        assert not tally.unasked, "no half of a body is written"
        assert not tally.corruptions
