"""The way down: a straight line, its ends never left, in time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.landing import Landing, landing
from gateway.core.leg import Servo
from gateway.core.pacing import NS_PER_MS

angles = st.integers(0, 180_00)
PERIOD_NS = 20 * NS_PER_MS


def one(first: int, last: int, length_ms: int = 1000) -> Landing:
    return landing(0, length_ms * NS_PER_MS, PERIOD_NS, {32: (first, last)})


def test_half_way_at_half_time() -> None:
    way = one(90_00, 30_00)
    assert [way.angle_cdeg(32, at_ms * NS_PER_MS) for at_ms in (0, 480, 960, 990, 1000)] == [
        90_00,
        60_00,
        30_00,
        30_00,
        30_00,
    ]


@given(angles, angles, st.integers(0, 5000), st.lists(st.integers(0, 6000), min_size=2))
def test_it_never_turns_round_and_never_leaves_its_ends(
    first: int, last: int, length_ms: int, times_ms: list[int]
) -> None:
    way = one(first, last, length_ms)
    said = [way.angle_cdeg(32, at_ms * NS_PER_MS) for at_ms in sorted(times_ms)]
    assert said == sorted(said, reverse=last < first)
    assert all(min(first, last) <= angle <= max(first, last) for angle in said)


@given(angles, angles, st.integers(0, 5000))
def test_it_has_arrived_two_rate_slots_before_the_end(first: int, last: int, length_ms: int) -> None:
    way = one(first, last, length_ms)
    assert way.angle_cdeg(32, max(0, way.ends_ns - 2 * PERIOD_NS)) == last


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
    way = landing(0, 1000 * NS_PER_MS, PERIOD_NS, {32: (90_00, 30_00), 33: (50_00, 50_00)})
    servos = [Servo(31, 3), *(Servo(32 + index, 3, angle) for index, angle in enumerate(angles_cdeg))]
    assert way.moves(servos) == moves
