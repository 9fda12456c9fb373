"""The way down: a straight line, its ends never left, in time."""

from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.allowance import NS_PER_MS
from gateway.robot.core.landing import Landing, landing
from gateway.robot.core.leg import Servo

angles = st.integers(0, 180_00)
PERIOD_NS = 20 * NS_PER_MS


def one(first: int, last: int, length_ms: int = 1000, late_ms: int = 0) -> Landing:
    """A landing of one servo, which begins so late."""
    end_ns, landing_ns = length_ms * NS_PER_MS, length_ms * NS_PER_MS
    return landing(late_ms * NS_PER_MS, end_ns, landing_ns, PERIOD_NS, {32: (first, last)})


def said_at(way: Landing, times_ms: Iterable[float]) -> list[int]:
    """What frames at these times say."""
    part_ns, said = 0, []
    for at_ms in times_ms:
        part_ns = way.next_part_ns(part_ns, round(at_ms * NS_PER_MS))
        said.append(way.angle_cdeg(32, part_ns))
    return said


@given(angles, angles, st.integers(0, 5000), st.lists(st.integers(0, 6000), min_size=2))
def test_it_never_turns_round_and_never_leaves_its_ends(
    first: int, last: int, length_ms: int, times_ms: list[int]
) -> None:
    said = said_at(one(first, last, length_ms), sorted(times_ms))
    assert said == sorted(said, reverse=last < first)
    assert all(min(first, last) <= angle <= max(first, last) for angle in said)


@given(angles, angles, st.integers(0, 5000), st.integers(0, 4000), st.lists(st.integers(0, 5000)))
@example(150_00, 30_00, 1000, 975, [980])  # a stall before it: 25 ms are left for 120 degrees
@example(150_00, 30_00, 1000, 0, [*range(20, 300, 20), 900, 920])  # a stall in its middle
def test_no_frame_goes_on_by_more_than_a_rate_slot_s_part(
    first: int, last: int, length_ms: int, late_ms: int, times_ms: list[int]
) -> None:
    """However late it begins, and whatever stalls come: what does not arrive in time is stopped where it is."""
    said = said_at(one(first, last, length_ms, late_ms), sorted(late_ms + at_ms for at_ms in times_ms))
    slots = max(1.0, length_ms / 20 - 2)
    for before, after in pairwise([first, *said]):
        assert abs(after - before) <= abs(last - first) / slots + 1


def test_a_frame_says_no_more_than_its_part_of_the_time_however_old_the_clock_is() -> None:
    way = landing(10**12, 10**12 + 1000 * NS_PER_MS, 1000 * NS_PER_MS, PERIOD_NS, {32: (90_00, 30_00)})
    assert way.next_part_ns(0, 10**12 + 7 * NS_PER_MS) == 7 * NS_PER_MS


@pytest.mark.parametrize(
    ("angles_cdeg", "moves"),
    [
        ((90_00, None), True),
        ((30_00, None), False),
        ((None, None), False),
        ((None, 50_00), False),
        ((31_00, 50_00), True),
    ],
    ids=["not there yet", "there", "stopped", "holds its angle", "one is not there yet"],
)
def test_a_leg_moves_while_a_running_servo_of_it_is_not_where_it_goes(
    angles_cdeg: tuple[int | None, int | None], moves: bool
) -> None:
    """Servo 31 did not run when the landing began, and has no way."""
    way = landing(0, 1000 * NS_PER_MS, 1000 * NS_PER_MS, PERIOD_NS, {32: (90_00, 30_00), 33: (50_00, 50_00)})
    servos = [Servo(31, 3), *(Servo(32 + index, 3, angle) for index, angle in enumerate(angles_cdeg))]
    assert way.moves(servos) == moves
