"""When a leg may send, and what: rate slots, merging, and the queue of starts."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.allowance import NS_PER_S
from gateway.model.frames import STOP, Op, ServoOp
from gateway.robot.core.pacing import RateSlots, StartQueue, merged

START_90, START_45 = ServoOp(Op.START, 90_00), ServoOp(Op.START, 45_00)
SET_90, SET_45 = ServoOp(Op.SET, 90_00), ServoOp(Op.SET, 45_00)


@pytest.mark.parametrize(
    ("older", "newer", "expected"),
    [
        (SET_90, SET_45, SET_45),
        (START_90, START_45, START_45),
        (START_90, SET_45, START_45),
        (SET_90, START_45, START_45),
        (START_90, STOP, STOP),
        (STOP, START_45, START_45),
    ],
)
def test_the_newest_target_counts_and_a_waiting_start_stays_a_start(
    older: ServoOp, newer: ServoOp, expected: ServoOp
) -> None:
    assert merged(older, newer) == expected


def sent(period_ns: int, arrivals_ns: list[int]) -> list[tuple[int, int]]:
    """When frames go out, and which arrival each carries: the newest. Whoever is pending is looked at when due."""
    slots = RateSlots(period_ns)
    frames: list[tuple[int, int]] = []
    pending: int | None = None
    for number, now_ns in enumerate(arrivals_ns):
        if pending is not None and slots.next_ns < now_ns:
            frames.append((slots.next_ns, pending))
            slots.take(slots.next_ns)
        pending = number
        if now_ns >= slots.next_ns:
            frames.append((now_ns, pending))
            slots.take(now_ns)
            pending = None
    if pending is not None:
        frames.append((slots.next_ns, pending))
    return frames


def sent_at(period_ns: int, arrivals_ns: list[int]) -> list[int]:
    """When frames go out."""
    return [at_ns for at_ns, _ in sent(period_ns, arrivals_ns)]


def test_a_robot_that_has_just_booted_has_all_its_slots_too() -> None:
    """At the clock's very beginning, with the longest period there is."""
    slots = RateSlots(NS_PER_S)
    for now_ns in (0, NS_PER_S // 4, NS_PER_S // 2):
        assert now_ns >= slots.next_ns
        slots.take(now_ns)
    assert slots.next_ns == NS_PER_S
    queue = StartQueue(pause_ns=1)
    assert queue.passes(3, RateSlots(NS_PER_S), 0, True)


def test_three_slots_are_kept_and_used_a_quarter_of_a_period_apart() -> None:
    """Nothing was sent for long: no more than three, and no burst."""
    assert sent_at(100, [1000, 1001, 1026, 1051, 1052]) == [1000, 1025, 1050, 1100]


def test_slots_that_nobody_used_are_skipped() -> None:
    """After ten periods there are three slots, not ten."""
    arrivals_ns = [1000, *range(2020, 2500, 5)]
    assert sent_at(100, arrivals_ns) == [1000, 2020, 2045, 2070, 2120, 2220, 2320, 2420, 2520]


def test_slots_come_on_their_grid_while_the_bucket_is_empty() -> None:
    """Who looks late does not push the later ones back."""
    slots = RateSlots(100)
    for now_ns in (1000, 1025, 1050):
        slots.take(now_ns)
    slots.take(1190)
    assert slots.next_ns == 1215
    slots.take(1215)
    assert slots.next_ns == 1300


PERIODS_NS = st.sampled_from([1, 3, 40, 50, 101])
ARRIVALS_NS = st.lists(st.integers(0, 60), min_size=1, max_size=80).map(
    lambda gaps: [1000 + sum(gaps[: number + 1]) for number in range(len(gaps))]
)


@given(PERIODS_NS, ARRIVALS_NS)
def test_two_frames_are_a_quarter_of_a_period_apart(period_ns: int, arrivals_ns: list[int]) -> None:
    assert all(4 * (later - earlier) >= period_ns for earlier, later in pairwise(sent_at(period_ns, arrivals_ns)))


@given(st.integers(2, 101), st.data())
def test_in_the_long_run_more_than_the_rate_gets_exactly_the_rate(period_ns: int, data: st.DataObject) -> None:
    """As soon as the bucket is empty, one frame in every period, to the nanosecond."""
    gap_ns = data.draw(st.integers(1, period_ns - 1))
    frames = sent_at(period_ns, list(range(1000, 1000 + 400 * period_ns, gap_ns)))
    empty = 2 + 3 * period_ns // (period_ns - gap_ns)  # a stream that is only just too fast takes long to empty it
    assert all(later - earlier == period_ns for earlier, later in pairwise(frames[empty:]))


def test_a_queue_lets_one_leg_go_at_a_time_in_the_order_in_which_they_came() -> None:
    queue, open_slots, late_slots = StartQueue(100), RateSlots(100), RateSlots(100, next_ns=2000)
    assert not queue.passes(3, late_slots, 1000, True)
    for leg in (1, 3, 2):
        assert not queue.passes(leg, late_slots if leg == 3 else open_slots, 1000, True)
    assert queue.legs == [3, 1, 2]
    assert queue.passes(4, open_slots, 1000, False), "a frame that starts nothing"
    assert queue.due_ns(1, 990) is None
    assert queue.passes(3, open_slots, 1000, True)
    assert not queue.passes(1, open_slots, 1099, True)
    assert queue.due_ns(1, 990) == 1100
    assert queue.due_ns(1, 1150) == 1150
    queue.leave(6)
    assert queue.passes(1, open_slots, 1100, False), "it is not started any more"
    assert queue.legs == [2]
    assert queue.passes(2, open_slots, 1100, True)
