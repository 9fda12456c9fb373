"""When a leg may send, and what: turns, merging, and the queue of starts."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.pacing import StartQueue, Turn, merged
from gateway.protocol.frames import STOP, Op, ServoOp

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


def sent_at(period_ns: int, arrivals_ns: list[int]) -> list[int]:
    """When frames go out, if commands come at these times and whoever waits is looked at in every nanosecond.

    The first is for a leg at rest.
    """
    turn = Turn(period_ns)
    sent: list[int] = []
    waits = False
    for now_ns in range(arrivals_ns[0], arrivals_ns[-1] + 3 * period_ns):
        arrived = now_ns in arrivals_ns
        if (waits or arrived) and turn.is_open(now_ns, something_waits=waits):
            turn.take(now_ns, at_rest=not sent)
            sent.append(now_ns)
            waits = False
        else:
            waits = waits or arrived
    return sent


def test_the_first_goes_out_at_once_and_what_comes_sooner_waits_a_period() -> None:
    assert sent_at(100, [1000, 1010, 1020]) == [1000, 1100]


def test_a_flood_is_sent_once_a_period() -> None:
    assert sent_at(100, list(range(1000, 1500, 5))) == [1000, 1100, 1200, 1300, 1400, 1500]


def test_a_stream_at_the_rate_is_never_delayed_by_its_own_jitter() -> None:
    jittered = [1000, 1108, 1195, 1303, 1391, 1500]
    assert sent_at(100, jittered) == jittered


def test_a_stream_at_the_rate_does_not_stay_late_because_its_first_frame_was() -> None:
    """The first was 40 late; the others are on time, and go out on time."""
    on_time = [1040, 1100, 1200, 1300, 1400, 1500]
    assert sent_at(100, on_time) == on_time


def test_missed_turns_are_skipped() -> None:
    """Nothing for ten periods, then four in a row: no burst, and the turns stay where they were."""
    assert sent_at(100, [1000, 2020, 2021, 2022, 2023]) == [1000, 2020, 2100]


def test_at_rest_the_turns_start_again_with_the_first_frame() -> None:
    turn = Turn(100, next_ns=1000, last_ns=900)
    turn.take(2050, at_rest=True)
    assert not turn.is_open(2149, something_waits=True)
    assert turn.is_open(2150, something_waits=True)


def test_a_leg_stopped_and_started_again_within_its_turn_has_no_more_turns_by_that() -> None:
    turn = Turn(100, next_ns=1100, last_ns=1000)
    turn.take(1060, at_rest=True)
    assert not turn.is_open(1199, something_waits=True)


@pytest.mark.parametrize("late_ns", range(0, 790, 7))
def test_a_stream_at_the_rate_goes_on_in_time_after_a_stall(late_ns: int) -> None:
    """One is late, and what was due meanwhile comes with it, as from a socket. Two periods later all is well."""
    due = range(1000, 3000, 100)
    stalled = [max(time_ns, 1200 + late_ns) if time_ns >= 1200 else time_ns for time_ns in due]
    on_time = [time_ns for time_ns in due if time_ns >= 1200 + late_ns + 200]
    sent = sent_at(100, stalled)
    assert [time_ns for time_ns in sent if time_ns >= on_time[0]] == on_time


def test_after_a_late_frame_the_next_waits_half_a_period_at_least() -> None:
    assert sent_at(100, [1000, 1190, 1191]) == [1000, 1190, 1240]


@settings(deadline=None)
@given(st.lists(st.integers(1000, 2500), min_size=1, max_size=60).map(lambda times: sorted(set(times))))
def test_no_arrivals_send_more_than_the_rate(arrivals_ns: list[int]) -> None:
    """In any stretch of n periods at most n + 2 frames, for each may be up to half early and less than one late."""
    period_ns = 50
    sent = sent_at(period_ns, arrivals_ns)
    assert all(later - earlier >= 0.5 * period_ns for earlier, later in itertools.pairwise(sent))
    for first, start_ns in enumerate(sent):
        for last in range(first, len(sent)):
            assert last - first + 1 <= (sent[last] - start_ns) / period_ns + 2.5


@settings(deadline=None)
@given(st.lists(st.integers(1000, 2500), min_size=1, max_size=60).map(lambda times: sorted(set(times))))
def test_what_waits_is_sent_within_a_turn(arrivals_ns: list[int]) -> None:
    """A period, and the half of one that the frame before may have been early."""
    sent = sent_at(50, arrivals_ns)
    for arrival_ns in arrivals_ns:
        assert any(arrival_ns <= sent_ns <= arrival_ns + 75 for sent_ns in sent)


def test_a_queue_without_a_pause_lets_all_go() -> None:
    queue = StartQueue(0)
    for leg in (3, 1):
        queue.join(leg)
        assert queue.admits(leg, 1000)
        queue.started(leg, 1000)
    assert queue.legs == []
    assert queue.turn_ns(3, 1234) == 1234


def test_a_queue_lets_one_leg_go_at_a_time_in_the_order_in_which_they_came() -> None:
    queue = StartQueue(100)
    for leg in (3, 1, 3, 2):
        queue.join(leg)
    assert queue.legs == [3, 1, 2]
    assert not queue.admits(1, 1000)
    assert queue.turn_ns(1, 990) is None
    assert queue.admits(3, 1000)
    queue.started(3, 1000)
    assert not queue.admits(1, 1099)
    assert queue.turn_ns(1, 990) == 1100
    assert queue.turn_ns(1, 1150) == 1150
    assert queue.admits(1, 1100)
    queue.leave(1)
    queue.leave(6)
    assert queue.admits(2, 1100)
