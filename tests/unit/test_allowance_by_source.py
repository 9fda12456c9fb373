"""Ten events of a source at once and ten a second, whatever the pattern, and none forgotten in the count."""

from collections import defaultdict

from hypothesis import given
from hypothesis import strategies as st

from gateway.allowance import MOST_SOURCES, AllowanceBySource
from gateway.robot.runtime.event_publisher import EVENTS_A_SECOND, EVENTS_AT_ONCE

S = 1_000_000_000
MS = 1_000_000


def test_names_of_a_second_ago_make_room() -> None:
    limit = AllowanceBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE)
    for n in range(1000):
        limit.admit(f"name {n}", 0)
    assert [limit.admit("new", S + n) for n in range(11)] == [0] * 10 + [None]


@given(
    st.lists(st.tuples(st.sampled_from(["a", "b", None, *(f"name {n}" for n in range(99))]), st.integers(0, 400)))
    | st.lists(st.tuples(st.just("a"), st.integers(0, 120)), min_size=30)
)
def test_never_more_than_promised_and_every_one_published_or_counted(rejections: list[tuple[str | None, int]]) -> None:
    limit = AllowanceBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE)
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
