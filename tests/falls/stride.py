"""A robot that stands or walks, at each phase of its stride: by the pure gait engine, in MuJoCo."""

import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Final, NamedTuple

from gateway.geometry import load
from gateway.people.physics.assumed import Assumed
from gateway.people.physics.world import World
from gateway.people.walking import GAITS, Engine, Robot, Velocity
from gateway.robot.settings import Settings
from tests.support.walked import copied
from tests.walking.__main__ import SPEEDS_M_S
from tests.walking.physics import TICK_S, angles_of, stand_up, walk

ELKAPOD: Final = Path(__file__).parents[2] / "examples" / "elkapod"
GEOMETRY: Final = load(ELKAPOD / "geometry.json")
"""Angles as commands name them, the same on both sides; so is the landing pose."""
SETTINGS: Final = Settings.of(tomllib.loads((ELKAPOD / "gateway.toml").read_text()))
ROBOT: Final = Robot(GEOMETRY)
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


def velocity(stance: str) -> Velocity:
    """At which it walks."""
    return Velocity(SPEEDS_M_S.get(stance, 0.0))


def stood_up(stance: str, assumed: Assumed) -> tuple[World, Engine]:
    """A robot that stands in this stance, or is about to walk so."""
    world = World(GEOMETRY, assumed)
    engine = Engine(ROBOT, "tripod" if stance == STAND else stance)
    world.lie_down({servo_id: GEOMETRY.joint_rad(servo_id, deg) for servo_id, deg in angles_of(engine).items()})
    stand_up(world, engine, GEOMETRY)
    return world, engine


def moments(stance: str, assumed: Assumed, phases: int = PHASES) -> list[Moment]:
    """The phases of a stride, each as just after a command; of a stand there is one."""
    world, engine = stood_up(stance, assumed)
    if stance == STAND:
        return [Moment(stance, 0, world, angles_of(engine), engine)]
    wanted, period_s = velocity(stance), GAITS[stance].period_s
    ticks = round(period_s / TICK_S)
    for _ in range(_STRIDES_BEFORE * ticks):
        walk(world, engine, GEOMETRY, wanted)
    found = []
    due = [round(phase * ticks / phases) for phase in range(phases)]
    for number in range(ticks):
        walk(world, engine, GEOMETRY, wanted)
        found += [
            Moment(stance, phase, deepcopy(world), angles_of(engine), copied(engine))
            for phase, at in enumerate(due)
            if at == number
        ]
    return found
