"""Bytes are lost on the wire: the controller is out of sync, and nothing comes back that could say so.

A sample of a minute's faults on the simulated controller, with the real conductor, supervisor and bus in virtual time.
"""

import logging
from collections.abc import Iterator

import pytest

from tests.deaf.faults import Tally, lose_bytes, lose_transfers
from tests.deaf.minute import minute, stopped_walk
from tests.deaf.recorded import recorded
from tests.support.robot import MS

pytestmark = pytest.mark.virtual_time

MINUTE_MS = 60_500
STOP_MS = 2_000
REST_MS = 5_000
"""How long a scene goes on after an emergency stop: until nothing more is written."""


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """A gateway says of each stop that it stopped, thousands of times here."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def check(tally: Tally) -> None:
    assert tally.stops_after_repeat == 0, "each Stop is executed at the latest with its first repeat"
    assert tally.deaf_ms <= 1000, "a stream is synchronised again within a second"
    assert not [what for what in tally.unasked if "out of sync" in what], "nothing moves but by half a body"


@pytest.mark.parametrize("tick_phase_ns", [0, 437_000])
async def test_a_byte_lost_anywhere(tick_phase_ns: int) -> None:
    tally = lose_bytes(await recorded(minute(), MINUTE_MS), every=113, tick_phase_ns=tick_phase_ns)
    assert tally.faults > 500
    assert tally.missed_first_stops > 50, "which the repeats are for"
    assert not tally.dead, "no lost byte kills the firmware"
    assert not tally.corruptions, "nor takes it outside its tables"
    assert tally.on_for_good == 0
    check(tally)


async def test_an_announcement_or_a_zero_lost_costs_no_controller_and_a_body_does() -> None:
    tallies = lose_transfers(await recorded(minute(), MINUTE_MS), every=41)
    assert tallies.keys() == {"a zero", "an announcement", "a body"}
    assert all(tally.faults > 90 for tally in tallies.values())
    assert tallies["a zero"].without_effect == tallies["a zero"].faults
    for kind in ("a zero", "an announcement"):
        check(tallies[kind])
        assert not tallies[kind].dead
        assert tallies[kind].on_for_good == 0
    assert tallies["a body"].dead > 0.1 * tallies["a body"].faults


@pytest.mark.nightly
@pytest.mark.parametrize("run", [1, 2, 3, 5, 9, 14, 20, 39, 100])
async def test_no_bytes_lost_inside_stops_leave_a_servo_on(run: int) -> None:
    """Of the first Stops, of their repeats, and of the runs behind them."""
    log = await recorded(stopped_walk(STOP_MS), STOP_MS + REST_MS)
    tally = lose_bytes(log, run=run, since_ns=STOP_MS * MS)
    assert tally.faults > 800
    assert not tally.dead
    assert tally.on_for_good == 0
