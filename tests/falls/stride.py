"""A robot that stands or walks, at each phase of its stride: by the pure gait engine, in MuJoCo."""

import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Final, NamedTuple

from gateway.geometry import load
from gateway.people.physics.assumed import Assumed
from gateway.people.physics.model import TIMESTEP_S
from gateway.people.physics.world import World
from gateway.people.walking import GAITS, Engine, Posture, Robot, Velocity
from gateway.robot.settings import Settings
from schemas.robot import JOINTS
from tests.walking.__main__ import SPEEDS_M_S
from tests.walking.physics import drive

ELKAPOD: Final = Path(__file__).parents[2] / "examples" / "elkapod"
GEOMETRY: Final = load(ELKAPOD / "geometry.json")
"""Angles as commands name them, the same on both sides; so is the landing pose."""
SETTINGS: Final = Settings.model_validate(tomllib.loads((ELKAPOD / "gateway.toml").read_text()))
ROBOT: Final = Robot(GEOMETRY)
TICK_S: Final = 0.02
PHASES: Final = 24
STAND: Final = "stand"
STANCES: Final = (STAND, *GAITS)
_STRIDES_BEFORE: Final = 2

Angles = dict[int, float]
"""Of each servo, in degrees as commands name them."""


class Moment(NamedTuple):
    """A robot in one phase, just after its latest command."""

    stance: str
    phase: int
    world: World
    """As it was then; whoever goes on with it takes a copy."""
    angles: Angles
    """Where it was sent."""
    engine: Engine
    """The same."""


def run(world: World, seconds: float) -> None:
    """Simulate that long."""
    for _ in range(round(seconds / TIMESTEP_S)):
        world.step()


def angles_of(engine: Engine) -> Angles:
    """Where it sends the legs that are not lost."""
    return {
        10 * leg + joint: angle_deg
        for leg, angles in engine.pose.items()
        for joint, angle_deg in zip(JOINTS, angles, strict=True)
    }


def velocity(stance: str) -> Velocity:
    """At which it walks."""
    return Velocity(SPEEDS_M_S.get(stance, 0.0))


def stood_up(stance: str, assumed: Assumed) -> tuple[World, Engine]:
    """A robot that stands in this stance, or is about to walk so."""
    world = World(GEOMETRY, assumed)
    engine = Engine(ROBOT, "tripod" if stance == STAND else stance)
    world.lie_down({servo_id: GEOMETRY.joint_rad(servo_id, deg) for servo_id, deg in angles_of(engine).items()})
    engine.stand()
    while engine.posture is not Posture.STANDING:
        tick(world, engine, Velocity())
    for _ in range(25):
        tick(world, engine, Velocity())
    return world, engine


def tick(world: World, engine: Engine, wanted: Velocity) -> None:
    """One command to all legs, and the time until the next."""
    engine.step(wanted, TICK_S)
    drive(world, angles_of(engine), GEOMETRY)
    run(world, TICK_S)


def moments(stance: str, assumed: Assumed, phases: int = PHASES) -> list[Moment]:
    """The phases of a stride, each as just after a command; of a stand there is one."""
    world, engine = stood_up(stance, assumed)
    if stance == STAND:
        return [Moment(stance, 0, world, angles_of(engine), engine)]
    wanted, period_s = velocity(stance), GAITS[stance].period_s
    ticks = round(period_s / TICK_S)
    for _ in range(_STRIDES_BEFORE * ticks):
        tick(world, engine, wanted)
    found = []
    due = [round(phase * ticks / phases) for phase in range(phases)]
    for number in range(ticks):
        tick(world, engine, wanted)
        found += [
            Moment(stance, phase, deepcopy(world), angles_of(engine), engine.copy())
            for phase, at in enumerate(due)
            if at == number
        ]
    return found
