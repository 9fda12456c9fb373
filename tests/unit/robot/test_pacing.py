"""When a leg may send, and what: rate slots, merging, and the queue of starts."""

from itertools import pairwise

from hypothesis import example, given
from hypothesis import strategies as st

from gateway.model.angle_limits import AngleLimits
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core.gates.rate import RateSlots
from gateway.robot.core.pace import Paces, step
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import RUNNING, Servo


def sent_at(period_ns: int, arrivals_ns: list[int]) -> list[int]:
    """When frames go out, each with the newest that has arrived. What is pending leaves when it is due."""
    slots = RateSlots(period_ns)
    frames_ns: list[int] = []
    pending = False
    for now_ns in arrivals_ns:
        if pending and slots.next_ns < now_ns:
            frames_ns.append(slots.next_ns)
            slots.take(slots.next_ns)
        pending = now_ns < slots.next_ns
        if not pending:
            frames_ns.append(now_ns)
            slots.take(now_ns)
    return frames_ns + [slots.next_ns] * pending


def test_three_slots_are_kept_and_used_a_quarter_of_a_period_apart() -> None:
    """Nothing was sent for long: no more than three, and no burst."""
    assert sent_at(100, [1000, 1001, 1026, 1051, 1052]) == [1000, 1025, 1050, 1100]


@given(st.integers(2, 101), st.data())
def test_in_the_long_run_more_than_the_rate_gets_exactly_the_rate(period_ns: int, data: st.DataObject) -> None:
    """As soon as the bucket is empty, one frame in every period, to the nanosecond."""
    gap_ns = data.draw(st.integers(1, period_ns - 1))
    frames = sent_at(period_ns, list(range(1000, 1000 + 400 * period_ns, gap_ns)))
    empty = 2 + 3 * period_ns // (period_ns - gap_ns)  # a stream that is only just too fast takes long to empty it
    assert all(later - earlier == period_ns for earlier, later in pairwise(frames[empty:]))


# ---- A limited speed: never more than speed times time, and the target is reached


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
        angle, since_ns = step(angle, target, speed, since_ns, now_ns, -(-speed * period_ns // NS_PER_S))
        assert abs(angle - before) * NS_PER_S < speed * period_ns + NS_PER_S, "no frame says more than a rate slot's"
        assert min(before, target) <= angle <= max(before, target)
        assert abs(angle - before) * NS_PER_S <= speed * wait_ns + NS_PER_S  # and rounding: a hundredth of a degree
        assert abs(angle - start) * NS_PER_S <= speed * now_ns  # which never adds up
        assert since_ns <= now_ns


def test_who_has_arrived_has_no_time_left_over() -> None:
    assert step(0, 1_00, 100_00, 0, 10 * NS_PER_MS + 1, 180_00) == (1_00, 10 * NS_PER_MS + 1)


# ---- The way down: a straight line, its ends never left, in time


PERIOD_NS = 20 * NS_PER_MS


@given(angles, angles, st.integers(0, 5000), st.integers(0, 4000), st.lists(st.integers(0, 5000)))
@example(150_00, 30_00, 1000, 975, [980])  # a stall before it: 25 ms are left for 120 degrees
@example(150_00, 30_00, 1000, 0, [*range(20, 300, 20), 900, 920])  # a stall in its middle
def test_no_frame_of_a_landing_has_more_than_a_rate_slot_s_part(
    first: int, last: int, length_ms: int, late_ms: int, times_ms: list[int]
) -> None:
    """However late it begins, and whatever stalls come: what does not arrive in time is stopped where it is."""
    pace = Paces(Rules(period_ns=PERIOD_NS, landing_ns=length_ms * NS_PER_MS), AngleLimits())
    servo = Servo(32, RUNNING, first)
    pace.land(servo, last, late_ms * NS_PER_MS)
    said = [first]
    for at_ms in sorted(times_ms):
        if servo.target is not None:
            said.append(pace.step(servo, (late_ms + at_ms) * NS_PER_MS, 0, lands=True).angle_cdeg)
    slots = max(1.0, length_ms / 20 - 2)
    for before, after in pairwise(said):
        assert abs(after - before) <= abs(last - first) / slots + 1
        assert min(first, last) <= after <= max(first, last)


@given(angles, angles, st.integers(60, 5000))
def test_a_landing_in_time_arrives_two_rate_slots_before_its_end(first: int, last: int, length_ms: int) -> None:
    pace = Paces(Rules(period_ns=PERIOD_NS, landing_ns=length_ms * NS_PER_MS), AngleLimits())
    servo = Servo(32, RUNNING, first)
    pace.land(servo, last, 0)
    for now_ns in range(PERIOD_NS, length_ms * NS_PER_MS - PERIOD_NS + 1, PERIOD_NS):
        if servo.target is not None:
            pace.step(servo, now_ns, 0, lands=True)
    assert servo.angle_cdeg == last
