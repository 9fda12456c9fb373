"""How often something may happen, in virtual time."""

from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from gateway.allowance import NS_PER_MS, NS_PER_S, Allowance

MS = 1_000_000


def test_units() -> None:
    assert (NS_PER_MS, NS_PER_S) == (MS, 1000 * MS)


def test_all_or_nothing() -> None:
    allowance = Allowance(a_second=10, at_once=3)
    assert not allowance.take(0, 4)
    assert allowance.is_full(0), "what was too much used nothing"
    assert allowance.take(0, 3)


def test_once_in_ten_seconds() -> None:
    allowance = Allowance(1 / 10, 1)
    assert [s for s in range(25) if allowance.take(s * NS_PER_S)] == [0, 10, 20]


@given(
    st.fractions(Fraction(1, 10), 10_000),
    st.integers(1, 50),
    st.lists(st.tuples(st.integers(0, 3 * NS_PER_S) | st.integers(0, 1000), st.integers(1, 60)), max_size=60),
)
def test_within_any_time_no_more_than_promised_and_the_wait_is_exact(
    a_second: Fraction, at_once: int, tries: list[tuple[int, int]]
) -> None:
    allowance, now_ns = Allowance(float(a_second), at_once), 0
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
