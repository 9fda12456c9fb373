"""How fast the body goes at the Elkapod's limits, in physics: reached, or the walk names the servo that is too slow."""

import math
from typing import Final, NamedTuple

import pytest

from gateway.geometry import MAX_SPEED_DEG_S, load
from gateway.model.servo import NO_LOAD_DEG_S
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import Velocity
from gateway.people.walking.robot import Range, Robot
from schemas.robot import SERVO_IDS
from tests.walking.physics import heading_rad, stood_up, walk

GEOMETRY: Final = load()
LIMITS: Final = {"tripod": Velocity(0.15, 0, 0.5), "ripple": Velocity(0.10, 0, 0.25), "wave": Velocity(0.05, 0, 0.1)}
"""The Elkapod's own, forward and turning at the same time."""
_BEGINS_S: Final = 3.0
_LASTS_S: Final = 12.0
_LOOK_S: Final = 0.1


class Reached(NamedTuple):
    """Of what was commanded, 0 to 1; and what limited it, in the walk's words."""

    forward: float
    turn: float
    limits: frozenset[str]


def reached(gait: str, servo_deg_s: float) -> Reached:
    """Both at once on a flat floor, with servos of this speed: means of twelve seconds."""
    wanted = LIMITS[gait]
    robot = Robot(GEOMETRY, {servo_id: Range(max_speed_deg_s=servo_deg_s) for servo_id in SERVO_IDS})
    engine = Engine(robot, gait)
    world = stood_up(GEOMETRY, engine)
    walk(world, engine, GEOMETRY, wanted, _BEGINS_S)
    ahead_m = turned_rad = 0.0
    limits = set()
    for _ in range(round(_LASTS_S / _LOOK_S)):
        (x_m, y_m, _), heading = world.body().position_m, heading_rad(world)
        walk(world, engine, GEOMETRY, wanted, _LOOK_S)
        turned = math.remainder(heading_rad(world) - heading, math.tau)
        (to_x_m, to_y_m, _), middle = world.body().position_m, heading + turned / 2
        ahead_m += (to_x_m - x_m) * math.cos(middle) + (to_y_m - y_m) * math.sin(middle)
        turned_rad += turned
        limits |= {engine.limit} - {""}
    return Reached(
        ahead_m / _LASTS_S / wanted.forward_m_s, turned_rad / _LASTS_S / wanted.turn_rad_s, frozenset(limits)
    )


@pytest.mark.parametrize("gait", LIMITS)
@pytest.mark.parametrize(
    ("servo_deg_s", "forward", "turn"), [(NO_LOAD_DEG_S, 0.92, 0.97), (MAX_SPEED_DEG_S, 0.85, 0.85)]
)
def test_forward_and_turn_are_reached_at_the_same_time_or_the_servo_that_is_too_slow_is_named(
    gait: str, servo_deg_s: float, forward: float, turn: float
) -> None:
    """Within a servo's own speed, and with the usual limit."""
    found = reached(gait, servo_deg_s)
    assert found.forward > forward
    assert found.turn > turn
    assert servo_deg_s == NO_LOAD_DEG_S or any("the speed of servo" in limit for limit in found.limits)
