"""How often something may happen, in virtual time."""

from collections import defaultdict
from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from gateway.rate_limit import MOST_SOURCES, NS_PER_S, RateLimit, RateLimitBySource
from gateway.robot.runtime.report import EVENTS_A_SECOND, EVENTS_AT_ONCE

MS = 1_000_000


def test_a_limit_lets_all_of_a_request_through_or_nothing() -> None:
    allowance = RateLimit(a_second=10, at_once=3)
    assert not allowance.take(0, 4)
    assert allowance.is_full(0), "what was too much used nothing"
    assert allowance.take(0, 3)


@given(
    st.fractions(Fraction(1, 10), 10_000),
    st.integers(1, 50),
    st.lists(st.tuples(st.integers(0, 3 * NS_PER_S) | st.integers(0, 1000), st.integers(1, 60)), max_size=60),
)
def test_within_any_time_no_more_than_promised_and_the_wait_is_exact(
    a_second: Fraction, at_once: int, tries: list[tuple[int, int]]
) -> None:
    allowance, now_ns = RateLimit(float(a_second), at_once), 0
    taken: list[tuple[int, int]] = []
    for pause_ns, count in tries:
        now_ns += pause_ns
        if allowance.take(now_ns, count):
            taken.append((now_ns, count))
        wait_ns = allowance.wait_ns(now_ns)
        assert not wait_ns or not allowance.take(now_ns + wait_ns - 1)
        now_ns += wait_ns
        assert allowance.take(now_ns)
        taken.append((now_ns, 1))
    for first, (begun_ns, _) in enumerate(taken):
        count = 0
        for at_ns, each in taken[first:]:
            count += each
            assert count <= at_once + a_second * (at_ns - begun_ns) / NS_PER_S * Fraction(1_000_001, 1_000_000)


# ---- by source: ten events at once and ten a second, and none forgotten in the count


S = 1_000_000_000


def test_names_of_a_second_ago_make_room() -> None:
    limit = RateLimitBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE)
    for n in range(1000):
        limit.admit(f"name {n}", 0)
    assert [limit.admit("new", S + n) for n in range(11)] == [0] * 10 + [None]


@given(
    st.lists(st.tuples(st.sampled_from(["a", "b", None, *(f"name {n}" for n in range(99))]), st.integers(0, 400)))
    | st.lists(st.tuples(st.just("a"), st.integers(0, 120)), min_size=30)
)
def test_never_more_than_promised_and_every_one_published_or_counted(rejections: list[tuple[str | None, int]]) -> None:
    limit = RateLimitBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE)
    now_ns = 0
    published_ns: defaultdict[str | None, list[int]] = defaultdict(list)
    accounted = 0
    for source, pause_ms in rejections:
        now_ns += pause_ms * MS
        left_out = limit.admit(source, now_ns)
        if left_out is not None:
            published_ns[source].append(now_ns)
            accounted += 1 + left_out
    for times in published_ns.values():
        for later, earlier in zip(times[EVENTS_AT_ONCE:], times, strict=False):
            assert later - earlier >= S // EVENTS_A_SECOND, "ten at once, and the eleventh a tenth of a second later"
        for later, earlier in zip(times[EVENTS_AT_ONCE + EVENTS_A_SECOND :], times, strict=False):
            assert later - earlier >= S
    assert accounted <= len(rejections)
    if len({source for source, _ in rejections}) < MOST_SOURCES:
        accounted += sum(limit.admit(source, now_ns + S) or 0 for source in published_ns)
        assert accounted == len(rejections)
