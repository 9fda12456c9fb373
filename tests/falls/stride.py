"""A robot that stands or walks, at phases of its stride: by the pure gait engine, in MuJoCo."""

import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Final, NamedTuple

from gateway.geometry import load
from gateway.people.physics.assumed import Assumed
from gateway.people.physics.world import World
from gateway.people.walking.engine import Engine
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.motion import Velocity
from gateway.people.walking.robot import Robot
from gateway.robot.settings import Settings
from tests.walking.physics import SPEEDS_M_S, TICK_S, angles_of, stood_up, walk

ELKAPOD: Final = Path(__file__).parents[2] / "examples" / "elkapod"
GEOMETRY: Final = load(ELKAPOD / "geometry.json")
"""Angles as commands name them, the same on both sides; so is the landing pose."""
SETTINGS: Final = Settings.of(tomllib.loads((ELKAPOD / "gateway.toml").read_text()))
PHASES: Final = 6
STAND: Final = "stand"
STANCES: Final = (STAND, *GAITS)
_STRIDES_BEFORE: Final = 2


class Moment(NamedTuple):
    """A robot in one phase, just after its latest command."""

    world: World
    """As it was then; whoever goes on with it takes a copy."""
    angles: dict[int, float]
    """Where each servo was sent, in degrees as commands name them."""


def moments(stance: str, assumed: Assumed) -> list[Moment]:
    """The phases of a stride, each as just after a command; of a stand there is one."""
    engine = Engine(Robot(GEOMETRY), "tripod" if stance == STAND else stance)
    world = stood_up(GEOMETRY, engine, assumed)
    if stance == STAND:
        return [Moment(world, angles_of(engine))]
    ticks = round(GAITS[stance].period_s / TICK_S)
    due = {_STRIDES_BEFORE * ticks + round(phase * ticks / PHASES) for phase in range(PHASES)}
    found = []
    for number in range((_STRIDES_BEFORE + 1) * ticks):
        walk(world, engine, GEOMETRY, Velocity(SPEEDS_M_S[stance]))
        if number in due:
            found.append(Moment(deepcopy(world), angles_of(engine)))
    return found
