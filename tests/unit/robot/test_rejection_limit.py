"""At most ten rejections told per second and source, whatever the pattern, and none forgotten in the count."""

from collections import defaultdict

from hypothesis import given
from hypothesis import strategies as st

from gateway.robot.core.rejection_limit import SOURCES, TOLD_PER_S, RejectionLimit

S = 1_000_000_000
MS = 1_000_000


def test_the_first_ten_are_told_and_no_more_within_the_second() -> None:
    limit = RejectionLimit()
    assert [limit.admit("a", n * MS) for n in range(10)] == [0] * 10
    assert [limit.admit("a", n * MS) for n in range(10, 1000)] == [None] * 990
    assert limit.admit("a", 1000 * MS) == 990
    assert limit.admit("a", 1001 * MS) == 0, "each is counted once"


def test_a_burst_at_the_end_of_a_second_is_not_followed_by_another() -> None:
    limit = RejectionLimit()
    assert limit.admit("a", 0) == 0
    told = [limit.admit("a", 990 * MS + n * MS) for n in range(30)]
    assert told.count(None) == 20, "nine at the end of the second, and one once the very first is a second old"
    assert [n for n, left_out in enumerate(told) if left_out is not None] == [*range(9), 10]


def test_sources_do_not_disturb_one_another() -> None:
    limit = RejectionLimit()
    for _ in range(100):
        limit.admit("loud", 0)
    assert limit.admit("quiet", 0) == 0
    assert limit.admit(None, 0) == 0, "one that is not known is a source too"


def test_whoever_invents_names_shares_one_allowance() -> None:
    limit = RejectionLimit()
    told = [limit.admit(f"name {n}", 0) for n in range(100_000)]
    assert sum(left_out is not None for left_out in told) == SOURCES + TOLD_PER_S
    assert limit.admit("name 0", 0) == 0, "a known one keeps its own"


def test_names_of_a_second_ago_make_room() -> None:
    limit = RejectionLimit()
    for n in range(1000):
        limit.admit(f"name {n}", 0)
    for n in range(TOLD_PER_S):
        assert limit.admit("new", S + n) == 0
    assert limit.admit("new", S + 100) is None


@given(
    st.lists(st.tuples(st.sampled_from(["a", "b", None, *(f"name {n}" for n in range(99))]), st.integers(0, 400)))
    | st.lists(st.tuples(st.just("a"), st.integers(0, 120)), min_size=30)
)
def test_never_more_than_ten_in_any_second_and_every_one_told_or_counted(
    rejections: list[tuple[str | None, int]],
) -> None:
    limit = RejectionLimit()
    now_ns = 0
    told_ns: defaultdict[str | None, list[int]] = defaultdict(list)
    told = accounted = 0
    for source, pause_ms in rejections:
        now_ns += pause_ms * MS
        left_out = limit.admit(source, now_ns)
        if left_out is not None:
            told_ns[source].append(now_ns)
            told += 1
            accounted += left_out
    for times in told_ns.values():
        assert all(later - earlier >= S for earlier, later in zip(times, times[TOLD_PER_S:], strict=False))
    assert told + accounted <= len(rejections)
    if rejections and len({source for source, _ in rejections}) < SOURCES:
        for source in told_ns:
            accounted += limit.admit(source, now_ns + S) or 0
        assert told + accounted == len(rejections)
