"""How fast the body goes in physics at the speeds that the Elkapod's own stack allows its gaits."""

import math
from typing import Final, NamedTuple

from gateway.people.physics.assumed import Assumed
from gateway.people.physics.world import World
from gateway.people.walking import Engine, Range, Robot, Velocity
from schemas.robot import SERVO_IDS
from tests.walking.physics import angles_of, stand_up, walk
from tests.walking.uneven import GEOMETRY

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
    engine, world = Engine(robot, gait), World(GEOMETRY, Assumed())
    world.lie_down({servo_id: GEOMETRY.joint_rad(servo_id, deg) for servo_id, deg in angles_of(engine).items()})
    stand_up(world, engine, GEOMETRY)
    walk(world, engine, GEOMETRY, wanted, _BEGINS_S)
    ahead_m = turned_rad = 0.0
    limits = set()
    for _ in range(round(_LASTS_S / _LOOK_S)):
        (x_m, y_m, _), heading = world.body().position_m, _heading(world)
        walk(world, engine, GEOMETRY, wanted, _LOOK_S)
        turned = math.remainder(_heading(world) - heading, math.tau)
        (to_x_m, to_y_m, _), middle = world.body().position_m, heading + turned / 2
        ahead_m += (to_x_m - x_m) * math.cos(middle) + (to_y_m - y_m) * math.sin(middle)
        turned_rad += turned
        limits |= {engine.limit} - {""}
    return Reached(
        ahead_m / _LASTS_S / wanted.forward_m_s, turned_rad / _LASTS_S / wanted.turn_rad_s, frozenset(limits)
    )


def _heading(world: World) -> float:
    x, y, z, w = world.body().rotation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
