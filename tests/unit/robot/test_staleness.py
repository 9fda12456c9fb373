"""Commands that were delayed: bursts after a stall, drifting clocks, restarts, many sources."""

import re
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.robot.core.staleness import CLOCKS, FORGET_MS, SOURCES, STEADY_MS, Staleness
from tests.support.delayed import MAX_AGE_MS, MS, NeverStopped, Publisher


@pytest.fixture
def staleness() -> Staleness:
    return NeverStopped(MAX_AGE_MS)


def test_a_burst_after_a_stall_is_rejected_until_it_is_fresh(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    assert not any(publisher.streams(0, 1000))
    burst = [publisher.arrives(4000 + index * 0.01, sent_at_ms=1000 + index * 20) for index in range(150)]
    ages_ms = [3000 - index * 19.99 for index in range(150)]
    assert all(late is not None for late, age_ms in zip(burst, ages_ms, strict=True) if age_ms > MAX_AGE_MS + 2)
    assert all(late is None for late, age_ms in zip(burst, ages_ms, strict=True) if age_ms < MAX_AGE_MS - 2)
    assert burst[0] == pytest.approx(3000, abs=2)
    assert not any(publisher.streams(4002, 5000))


@pytest.mark.parametrize("silence_ms", [1e4, 1e6, 3.6e6])
def test_the_burst_is_known_for_one_after_any_silence(staleness: Staleness, silence_ms: float) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    drift_ms = 200e-6 * silence_ms
    late_ms = publisher.arrives(1000 + silence_ms, sent_at_ms=1000 + silence_ms - drift_ms - MAX_AGE_MS - 5)
    assert late_ms is not None


def test_jitter_below_the_limit_passes(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    delays_ms = [0, 150, 3, 199, 0, 180] * 50
    assert all(
        publisher.arrives(index * 20 + delay_ms, sent_at_ms=index * 20) is None
        for index, delay_ms in enumerate(delays_ms)
    )


@pytest.mark.parametrize("ppm", [-100, 100])
def test_a_drifting_clock_is_not_locked_out_in_a_day(staleness: Staleness, ppm: float) -> None:
    publisher = Publisher(staleness, ppm=ppm)
    assert not any(publisher.streams(0, 86_400_000, period_ms=1000))


def test_drift_adds_nothing_to_the_baseline_of_a_clock_that_is_heard(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 200_000)
    assert publisher.arrives(200_000 + MAX_AGE_MS + 5, sent_at_ms=200_000) is not None


def test_drift_does_not_hide_a_delay(staleness: Staleness) -> None:
    publisher = Publisher(staleness, ppm=-100)
    publisher.streams(0, 3_600_000, period_ms=100)
    assert publisher.arrives(3_600_300, sent_at_ms=3_600_000) is not None


@pytest.mark.parametrize("zero_ms", [0.0, -3_000_000.0, 4.9e6])
def test_a_publisher_whose_clock_jumps_back_is_not_locked_out(staleness: Staleness, zero_ms: float) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 10_000)
    publisher.zero_ms = zero_ms
    assert not any(publisher.streams(60_000, 61_000))


def test_a_program_with_its_own_zero_that_restarts_early_is_locked_out_for_five_seconds_at_most(
    staleness: Staleness,
) -> None:
    publisher = Publisher(staleness, zero_ms=0)
    publisher.streams(0, 800)
    publisher.zero_ms = -10_000
    rejected = publisher.streams(10_000, 20_000)
    assert sum(rejected) * 20 == pytest.approx(STEADY_MS, abs=40)
    assert not any(rejected[260:])


def test_a_clock_that_jumps_back_further_than_a_link_can_hold_is_a_new_one(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 10_000)
    publisher.zero_ms -= 21_000
    assert not any(publisher.streams(10_000, 40_000))


def test_a_delay_that_is_steady_for_less_than_five_seconds_is_none_for_good(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    assert all(publisher.streams(1000, 5900, delay_ms=700))


def test_a_delay_that_grows_is_never_steady(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    for index in range(500):
        sent_ms = 1000 + index * 20
        assert publisher.arrives(sent_ms + MAX_AGE_MS + 5 + index * 2, sent_at_ms=sent_ms) is not None


def test_stalls_again_and_again_never_pass_for_a_steady_way(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    for now_ms in range(1000, 20_000, 720):
        assert publisher.arrives(now_ms, sent_at_ms=now_ms) is None
        assert publisher.arrives(now_ms + 710, sent_at_ms=now_ms + 10) is not None or now_ms == 1000


def test_a_queue_that_empties_slowly_never_passes_for_a_steady_way(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    # 30 s of commands come through in 20 s: each arrives a little less late than the one before.
    rejected = []
    for index in range(1500):
        sent_ms = 1000 + index * 20
        arrival_ms = 31_000 + index * 20 * 2 / 3
        rejected.append((publisher.arrives(arrival_ms, sent_at_ms=sent_ms) is not None, arrival_ms - sent_ms))
    assert all(was_rejected for was_rejected, age_ms in rejected if age_ms > MAX_AGE_MS + 20)


def test_bursts_with_pauses_between_them_never_pass_for_a_steady_way(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    assert all(
        publisher.arrives(10_000 + index * 2000, sent_at_ms=5000 + index * 2000) is not None for index in range(10)
    )


def test_a_delay_of_just_what_is_allowed_is(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    assert publisher.arrives(1000) is None
    assert publisher.arrives(1000, sent_at_ms=1000 - MAX_AGE_MS) is None
    assert publisher.arrives(1000, sent_at_ms=1000 - MAX_AGE_MS - 0.5) is not None


def test_commands_of_one_instant_may_come_in_any_order(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    # After a stall the keys' rings are read one after the other: leg 1's newest, then leg 2's older ones.
    assert publisher.arrives(9000, sent_at_ms=8990) is None
    assert publisher.arrives(9000, sent_at_ms=2000) is not None
    for sent_at_ms, now_ms in ((60_000, 60_000.3), (9020, 60_000.6)):  # to deal with the first one takes time
        said = staleness.too_old(publisher.name, publisher.clock_ms(sent_at_ms), round(now_ms * MS), 60_000 * MS)
    assert said is not None


def test_sources_do_not_disturb_each_other(staleness: Staleness) -> None:
    first, second = Publisher(staleness, name="a"), Publisher(staleness, name="b", zero_ms=0)
    for begin_ms in range(0, 1000, 100):
        assert not any(first.streams(begin_ms, begin_ms + 100))
        assert not any(second.streams(begin_ms, begin_ms + 100))
    assert first.arrives(3000, sent_at_ms=1000) is not None
    assert second.arrives(3000) is None


def test_a_source_is_forgotten_only_after_a_minute_of_silence(staleness: Staleness) -> None:
    first = Publisher(staleness, name="first")
    first.streams(0, 100)
    others = [Publisher(staleness, name=f"source {number}", zero_ms=number) for number in range(SOURCES)]
    said = [other.asks(100) for other in others]
    assert said[:-1] == [None] * (SOURCES - 1)
    assert said[-1] is not None
    assert re.fullmatch(
        r"256 sources have sent commands within 60 s, more than .* wait, or leave out sent_ms", said[-1]
    )
    assert first.arrives(1300, sent_at_ms=1000) is not None, "its burst is known for one"
    assert others[-1].asks(100 + FORGET_MS) is None, "one of the silent ones is forgotten"
    assert len(staleness._sources) == SOURCES
    assert first.arrives(100 + FORGET_MS, sent_at_ms=FORGET_MS - 200) is not None


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 2**53), st.integers(0, 10**10)), max_size=60))
def test_whatever_comes_what_is_remembered_is_bounded(commands: list[tuple[str, float, int]]) -> None:
    staleness, now_ns = NeverStopped(MAX_AGE_MS), 0
    for name, sent_ms, wait_ns in commands:
        now_ns += wait_ns
        staleness.too_old(name, sent_ms, now_ns, now_ns)
    assert all(len(clocks) <= CLOCKS for clocks, _ in staleness._sources.values())


def test_memory_is_bounded(staleness: Staleness) -> None:
    tracemalloc.start()
    try:
        for index in range(10 * SOURCES):
            for clock in range(2 * CLOCKS):
                staleness.too_old(f"{index % (2 * SOURCES)}", clock * 1e6, index * MS, index * MS)
        assert len(staleness._sources) == SOURCES
        assert tracemalloc.get_traced_memory()[0] < 1_500_000
    finally:
        tracemalloc.stop()
