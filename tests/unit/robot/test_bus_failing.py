"""What the controller may still await after calls that failed, and the shortest way back.

Which calls the bus makes of it: test_bus.py.
"""

import itertools

import pytest

from gateway.model.frames import STOP, OneServo, stop_leg
from gateway.model.framing import ZERO, Framing
from gateway.robot.spi.awaited import ANYTHING, NOTHING, after, after_failure, next_on_the_way_back
from schemas.robot import LEGS, SERVO_IDS
from tests.support.controllers import Controller

LEG_STOPS = tuple(stop_leg(leg).to_bytes() for leg in LEGS)
STOPS = (*LEG_STOPS, *(OneServo(servo_id, STOP).to_bytes() for servo_id in SERVO_IDS))


def transfers_of(stop: bytes) -> tuple[bytes, ...]:
    return (ZERO,) if stop == ZERO else (stop[:1], stop)


def awaiting(count: int) -> Controller:
    """A controller with no servo on that awaits so many bytes."""
    controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda: 0)
    controller.take(bytes((count,)))
    assert controller.missing == count
    return controller


@pytest.mark.parametrize("count", range(64))
def test_from_wherever_a_controller_is_stops_and_zeros_start_nothing_and_harm_nothing(count: int) -> None:
    """And what it then awaits is what is computed, for each two of them."""
    for pair in itertools.product((*STOPS[:8], STOPS[-1], ZERO), (*STOPS, ZERO)):
        controller, awaited = awaiting(count), frozenset({count})
        for stop in pair:
            for data in transfers_of(stop):
                controller.take(data)
                awaited = after(awaited, (data,))
        assert awaited == {controller.missing}, pair
        assert not controller.energised
        assert not controller.corruptions
        assert controller.dead is None


def test_what_may_have_been_lost_is_each_transfer_and_those_behind_it() -> None:
    assert after_failure(NOTHING, ()) == NOTHING
    assert after_failure(NOTHING, [ZERO] * 16) == NOTHING, "zeros do a synchronised controller nothing"
    assert after_failure(NOTHING, transfers_of(LEG_STOPS[0])) == {0, 14}
    assert after_failure(frozenset({0, 14}), transfers_of(LEG_STOPS[0])) == {0, 13, 14}
    assert after_failure(ANYTHING, [ZERO]) == ANYTHING
    assert after(ANYTHING, [ZERO] * 14) == NOTHING
    assert after(ANYTHING, [ZERO] * 13) == {0, 1}, "all 14 bytes of a leg's frame may be missing"


def test_where_stops_lead_nowhere_soon_it_is_zeros() -> None:
    assert next_on_the_way_back(ANYTHING, LEG_STOPS[:3]) == ZERO
    assert next_on_the_way_back(frozenset({1}), LEG_STOPS[:3]) == ZERO, "one transfer, not two"
