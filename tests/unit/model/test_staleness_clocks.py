"""Delayed commands where several clocks stand behind one name: forgers, programs of one name, restarts."""

import pytest

from gateway.model.staleness import CLOCKS, Staleness
from tests.support.delayed import MAX_AGE_MS, MS, NeverStopped, Publisher


@pytest.fixture
def staleness() -> Staleness:
    return NeverStopped(MAX_AGE_MS)


@pytest.mark.parametrize("ahead_ms", [MAX_AGE_MS + 1, 600, 1500, 19_000, 3_600_000, -21_000, -3_600_000, 51, 100])
@pytest.mark.parametrize("times", [1, 100])
@pytest.mark.parametrize("heard_ms", [20, 400, 10_000])
def test_a_forged_source_does_not_lock_its_owner_out(
    staleness: Staleness, ahead_ms: float, times: int, heard_ms: float
) -> None:
    owner, forger = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + ahead_ms)
    assert not any(owner.streams(0, heard_ms))
    for index in range(times):
        forger.asks(heard_ms + index * 0.01)
    assert not any(owner.streams(heard_ms + 2, heard_ms + 3000))


def test_a_clock_that_is_pushed_ahead_little_by_little_does_not_lock_its_owner_out(staleness: Staleness) -> None:
    owner = Publisher(staleness)
    owner.streams(0, 1000)
    for ahead_ms in range(40, 4000, 40):
        Publisher(staleness, zero_ms=5e6 + ahead_ms).asks(1000)
    assert not any(owner.streams(1001, 9000))


def test_a_slow_clocks_owner_is_not_locked_out_after_an_hour_either(staleness: Staleness) -> None:
    owner = Publisher(staleness, ppm=-100)
    owner.streams(0, 3_600_000, period_ms=1000)
    forger = Publisher(staleness, zero_ms=owner.clock_ms(3_600_000) - 3_600_000 + MAX_AGE_MS + 100)
    forger.asks(3_600_000)
    assert not any(owner.streams(3_600_001, 3_602_000))


@pytest.mark.parametrize("ahead_ms", [600, 19_000, 3_600_000, -21_000, -3_600_000])
def test_beside_a_forged_clock_the_owners_burst_is_still_known_for_one(staleness: Staleness, ahead_ms: float) -> None:
    owner, forger = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + ahead_ms)
    owner.streams(0, 6000)
    forger.asks(6001)
    owner.streams(6002, 7000)
    burst = [owner.arrives(10_000 + index * 0.01, sent_at_ms=7000 + index * 20) for index in range(130)]
    assert all(late is not None for late in burst)


def test_a_new_clock_takes_the_place_of_the_proven_one_that_is_silent_for_longest(staleness: Staleness) -> None:
    *proven, new = (Publisher(staleness, zero_ms=number * 1e6) for number in range(CLOCKS + 1))
    for begin_ms, publisher in zip(range(0, 54_000, 6000), (*proven, proven[0]), strict=True):
        publisher.streams(begin_ms, begin_ms + 6000)
    assert new.arrives(54_000) is None
    assert proven[0].arrives(55_000, sent_at_ms=54_400) is not None
    assert proven[1].arrives(55_000, sent_at_ms=54_400) is None, "as a clock that nobody knows"


@pytest.mark.parametrize("sent_at_ms", [5350, 6000], ids=["out of order", "in order, and both are proven"])
def test_an_old_command_between_two_clocks_is_judged_by_the_one_heard_last(
    staleness: Staleness, sent_at_ms: float
) -> None:
    behind, ahead = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + 600)
    for index in range(300):
        assert behind.arrives(index * 20) is None
        assert ahead.arrives(index * 20 + 10) is None
    assert ahead.arrives(sent_at_ms + 650, sent_at_ms=sent_at_ms) is not None, "50 ms old by the other's clock"


@pytest.mark.parametrize(
    ("apart_ms", "delay_ms", "late_ms", "later_ms"),
    [
        (600, 200, None, 250),  # just fresh by the one heard for longest
        (600, 201, 801, 850),
        (100, 100, None, 350),  # just fresh by the one heard last, which is believed first
    ],
)
def test_of_two_clocks_the_one_heard_last_is_believed_and_then_the_one_heard_for_longest(
    staleness: Staleness, apart_ms: float, delay_ms: float, late_ms: float | None, later_ms: float
) -> None:
    behind, ahead = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + apart_ms)
    said = [
        staleness.too_old(publisher.name, publisher.clock_ms(now_ms - before_ms), now_ms * MS, 1000 * MS)
        for publisher, now_ms, before_ms in (
            *((behind, 1000, 0), (behind, 1010, 0), (ahead, 1020, 0)),
            *((behind, 2000, delay_ms), (behind, 2001, 250)),
        )
    ]
    delays = [None if why is None else float(why.split()[5]) for why in said]
    assert delays == [None, None, None, late_ms, later_ms]


def test_an_old_command_that_is_let_in_lets_no_older_one_of_another_clock_in(staleness: Staleness) -> None:
    behind, ahead = Publisher(staleness, zero_ms=5e6 - 600), Publisher(staleness)
    for index in range(100):
        assert behind.arrives(index * 20) is None
        assert ahead.arrives(index * 20 + 10) is None
    assert behind.arrives(2000) is None
    assert behind.arrives(2001, sent_at_ms=2001 - 150) is None
    assert ahead.arrives(2002) is None
    assert ahead.arrives(2003, sent_at_ms=2003 - 700) is not None
