"""Both of the Elkapod's limits at once, in physics: reached, or the walk names the servo that is too slow."""

import pytest

from gateway.geometry import MAX_SPEED_DEG_S
from gateway.model.power_board import NO_LOAD_DEG_S
from tests.walking.fast import LIMITS, reached


@pytest.mark.parametrize("gait", LIMITS)
def test_within_a_servos_own_speed_forward_and_turn_are_reached_at_the_same_time(gait: str) -> None:
    found = reached(gait, NO_LOAD_DEG_S)
    assert found.forward > 0.92
    assert found.turn > 0.97


@pytest.mark.parametrize("gait", LIMITS)
def test_with_the_usual_limit_of_speed_the_walk_names_the_servo_that_is_too_slow(gait: str) -> None:
    found = reached(gait, MAX_SPEED_DEG_S)
    assert found.forward > 0.85
    assert found.turn > 0.85
    assert any("the speed of servo" in limit for limit in found.limits)
