"""A limited speed: never more than speed times time, and the target is reached."""

from hypothesis import example, given
from hypothesis import strategies as st

from gateway.core.pacing import NS_PER_MS, NS_PER_S
from gateway.core.speed import step

angles = st.integers(0, 180_00)
speeds = st.integers(1, 1000_00)


waits = st.integers(0, 200 * NS_PER_MS)


@given(angles, speeds, st.lists(st.tuples(angles, waits), min_size=1, max_size=50))
@example(0, 18981, [(352, 158053), (352, 18386807)])
@example(0, 100_00, [(1_00, 100 * NS_PER_MS), (180_00, 10 * NS_PER_MS)])  # there early, and then on
def test_never_more_than_speed_times_time(start: int, speed: int, targets: list[tuple[int, int]]) -> None:
    angle, since_ns, now_ns = start, 0, 0
    for target, wait_ns in targets:
        before = angle
        now_ns += wait_ns
        angle, since_ns = step(angle, target, speed, since_ns, now_ns)
        assert min(before, target) <= angle <= max(before, target)
        assert abs(angle - before) * NS_PER_S <= speed * wait_ns + NS_PER_S  # and rounding: a hundredth of a degree
        assert abs(angle - start) * NS_PER_S <= speed * now_ns  # which never adds up
        assert since_ns <= now_ns


def test_who_has_arrived_has_no_time_left_over() -> None:
    assert step(0, 1_00, 100_00, 0, 10 * NS_PER_MS + 1) == (1_00, 10 * NS_PER_MS + 1)


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
