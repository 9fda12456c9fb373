"""A limited speed: never more than speed times time, and the target is reached."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.robot.core.speed import step

angles = st.integers(0, 180_00)
speeds = st.integers(1, 1000_00)


waits = st.integers(0, 200 * NS_PER_MS)
periods = st.integers(NS_PER_MS, NS_PER_S)
LONG_NS = 10**6 * NS_PER_S
"""A rate slot that bounds nothing."""


@given(angles, speeds, periods, st.lists(st.tuples(angles, waits), min_size=1, max_size=50))
@example(0, 18981, LONG_NS, [(352, 158053), (352, 18386807)])
@example(0, 100_00, LONG_NS, [(1_00, 100 * NS_PER_MS), (180_00, 10 * NS_PER_MS)])  # there early, and then on
def test_never_more_than_speed_times_time(
    start: int, speed: int, period_ns: int, targets: list[tuple[int, int]]
) -> None:
    angle, since_ns, now_ns = start, 0, 0
    for target, wait_ns in targets:
        before = angle
        now_ns += wait_ns
        angle, since_ns = step(angle, target, speed, since_ns, now_ns, period_ns)
        assert abs(angle - before) * NS_PER_S < speed * period_ns + NS_PER_S, "no frame says more than a rate slot's"
        assert min(before, target) <= angle <= max(before, target)
        assert abs(angle - before) * NS_PER_S <= speed * wait_ns + NS_PER_S  # and rounding: a hundredth of a degree
        assert abs(angle - start) * NS_PER_S <= speed * now_ns  # which never adds up
        assert since_ns <= now_ns


def test_time_too_short_for_a_hundredth_is_kept_for_the_next_step() -> None:
    slot_ns = 20 * NS_PER_MS
    assert step(0, 180_00, 50_00, 0, slot_ns + 100, slot_ns) == (1_00, slot_ns)


def test_who_has_arrived_has_no_time_left_over() -> None:
    assert step(0, 1_00, 100_00, 0, 10 * NS_PER_MS + 1, LONG_NS) == (1_00, 10 * NS_PER_MS + 1)


@pytest.mark.parametrize("stall_ms", [21, 600, 100_000])
@pytest.mark.parametrize("way", [1, -1])
def test_after_a_stall_a_step_is_no_longer_than_one_in_time(stall_ms: int, way: int) -> None:
    """60 degrees a second, 50 frames a second: 1.2 degrees with each."""
    now_ns = stall_ms * NS_PER_MS
    first = step(90_00, 90_00 + way * 80_00, 60_00, 0, now_ns, 20 * NS_PER_MS)
    assert first == (90_00 + way * 1_20, now_ns), "what was lost is not made up for"
    soon = step(first.angle_cdeg, 90_00 + way * 80_00, 60_00, first.since_ns, now_ns + 5 * NS_PER_MS, 20 * NS_PER_MS)
    assert soon.angle_cdeg == first.angle_cdeg + way * 30
