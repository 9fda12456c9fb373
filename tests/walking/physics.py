"""A robot in MuJoCo (gateway/people/physics/world.py): driven by frames, and by the pure gait engine."""

import math
from collections.abc import Callable, Mapping
from typing import Final

from gateway.geometry import Geometry
from gateway.people.physics.assumed import USUAL, Assumed
from gateway.people.physics.world import TIMESTEP_S, World
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import STILL, Posture, Velocity
from schemas.robot import JOINTS
from schemas.telemetry import Telemetry

TICK_S: Final = 0.02
SPEEDS_M_S: Final = {"tripod": 0.08, "ripple": 0.04, "wave": 0.02}
"""Two thirds of what each gait's strides reach."""
FALLEN_DEG: Final = 30.0
SUNK_M: Final = 0.092
"""The middle of a body with slack servos comes below this height. It stands at 0.154, and lies flat at 0.058.

Slack legs fold below it: tibias lie under one side, their femurs at their end stops, and hold that side up, while a
corner of the belly is on the ground. That corner is 0.236 m from the middle, which a lean of 8 degrees lifts by 0.03.
"""
SINKS_S: Final = 4.0
"""Slack legs brake it, and most of it is done in half a second; then it creeps into its last centimetre."""

Sent = tuple[float, Mapping[int, float | None]]
"""When (seconds), and where servos are sent, in degrees; None: stopped."""
Sense = Callable[[World], Telemetry | None]
"""What the robot measures; None: nothing."""


def blind(_: World) -> None:
    """Measure nothing."""


def drive(world: World, angles: Mapping[int, float | None], geometry: Geometry) -> None:
    """Send servos there, in angles of this geometry."""
    for servo_id, angle_deg in angles.items():
        world.drive(servo_id, None if angle_deg is None else geometry.joint_rad(servo_id, angle_deg))


def run(world: World, seconds: float) -> None:
    for _ in range(round(seconds / TIMESTEP_S)):
        world.step()


def walk(world: World, engine: Engine, wanted: Velocity, seconds: float = TICK_S, sense: Sense = blind) -> None:
    """Walk as a gateway passes setpoints on, 50 a second, with the time until the next."""
    for _ in range(round(seconds / TICK_S)):
        engine.step(wanted, TICK_S, sense(world))
        drive(world, angles_of(engine), engine.robot.geometry)
        run(world, TICK_S)


def stand_up(world: World, engine: Engine, sense: Sense = blind) -> None:
    """Stand up by its walk, and wait half a second longer."""
    engine.stand()
    while engine.posture is not Posture.STANDING:
        walk(world, engine, STILL, sense=sense)
    walk(world, engine, STILL, 0.5, sense)


def angles_of(engine: Engine) -> dict[int, float]:
    return {
        10 * leg + joint: angle_deg
        for leg, angles in engine.pose.items()
        for joint, angle_deg in zip(JOINTS, angles, strict=True)
    }


def stood_up(engine: Engine, assumed: Assumed = USUAL, sense: Sense = blind) -> World:
    """Return a robot that stands up from where this engine lies."""
    geometry = engine.robot.geometry
    world = World(geometry, assumed)
    world.lie_down({servo_id: geometry.joint_rad(servo_id, deg) for servo_id, deg in angles_of(engine).items()})
    stand_up(world, engine, sense)
    return world


def heading_rad(world: World) -> float:
    x, y, z, w = world.body().rotation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
