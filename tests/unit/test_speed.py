"""A limited speed: never more than speed times time, and the target is reached."""

from hypothesis import example, given
from hypothesis import strategies as st

from gateway.core.pacing import NS_PER_MS, NS_PER_S
from gateway.core.speed import step

angles = st.integers(0, 180_00)
speeds = st.integers(1, 1000_00)


@given(angles, angles, speeds, st.lists(st.integers(0, 200 * NS_PER_MS), min_size=1, max_size=50))
@example(0, 352, 18981, [158053, 18386807])
def test_never_more_than_speed_times_time(start: int, target: int, speed: int, waits_ns: list[int]) -> None:
    angle, since_ns, now_ns = start, 0, 0
    for wait_ns in waits_ns:
        before = angle
        now_ns += wait_ns
        angle, since_ns = step(angle, target, speed, since_ns, now_ns)
        assert min(before, target) <= angle <= max(before, target)
        assert abs(angle - before) * NS_PER_S <= speed * wait_ns + NS_PER_S  # and rounding: a hundredth of a degree
        assert abs(angle - start) * NS_PER_S <= speed * now_ns  # which never adds up
        assert since_ns <= now_ns


@given(angles, angles, speeds, st.integers(1, 1000))
def test_the_target_is_reached_in_its_time_however_often_it_is_asked(
    start: int, target: int, speed: int, steps: int
) -> None:
    needed_ns = -(-abs(target - start) * NS_PER_S // speed) + steps  # a nanosecond is lost in each step
    angle, since_ns = start, 0
    for number in range(1, steps + 1):
        angle, since_ns = step(angle, target, speed, since_ns, number * needed_ns // steps)
    angle, since_ns = step(angle, target, speed, since_ns, needed_ns + 2 * steps)
    assert angle == target
