"""Ten events of a source at once and ten a second, whatever the pattern, and none forgotten in the count."""

from collections import defaultdict

from hypothesis import given
from hypothesis import strategies as st

from gateway.robot.core.rejection_limit import EVENTS_A_SECOND, EVENTS_AT_ONCE, SOURCES_COUNTED, RejectionLimit

S = 1_000_000_000
MS = 1_000_000


def test_the_first_ten_are_published_and_then_ten_a_second() -> None:
    limit = RejectionLimit()
    assert [limit.admit("a", 0) for _ in range(12)] == [0] * 10 + [None] * 2
    published = {n: left_out for n in range(1, 1001) if (left_out := limit.admit("a", n * MS)) is not None}
    assert published == {100: 101, **dict.fromkeys(range(200, 1001, 100), 99)}, "each is counted once"


def test_sources_do_not_disturb_one_another() -> None:
    limit = RejectionLimit()
    for _ in range(100):
        limit.admit("loud", 0)
    assert limit.admit("quiet", 0) == 0
    assert limit.admit(None, 0) == 0, "one that is not known is a source too"


def test_whoever_invents_names_shares_one_allowance() -> None:
    limit = RejectionLimit()
    published = [limit.admit(f"name {n}", 0) for n in range(100_000)]
    assert sum(left_out is not None for left_out in published) == SOURCES_COUNTED + EVENTS_AT_ONCE
    assert limit.admit("name 0", 0) == 0, "a known one keeps its own"


def test_names_of_a_second_ago_make_room() -> None:
    limit = RejectionLimit()
    for n in range(1000):
        limit.admit(f"name {n}", 0)
    assert [limit.admit("new", S + n) for n in range(11)] == [0] * 10 + [None]


@given(
    st.lists(st.tuples(st.sampled_from(["a", "b", None, *(f"name {n}" for n in range(99))]), st.integers(0, 400)))
    | st.lists(st.tuples(st.just("a"), st.integers(0, 120)), min_size=30)
)
def test_never_more_than_promised_and_every_one_published_or_counted(rejections: list[tuple[str | None, int]]) -> None:
    limit = RejectionLimit()
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
    if len({source for source, _ in rejections}) < SOURCES_COUNTED:
        accounted += sum(limit.admit(source, now_ns + S) or 0 for source in published_ns)
        assert accounted == len(rejections)
