"""Uneven ground in physics: with sensors the body leans half as much, and it walks over no edge."""

import math
from collections import deque
from collections.abc import Callable
from functools import cache, partial
from typing import Final, NamedTuple

import pytest

from gateway.geometry import load
from gateway.model.telemetry import report_of
from gateway.people.physics.assumed import Assumed, Terrain
from gateway.people.physics.world import World
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import STILL, Velocity
from gateway.people.walking.robot import Robot
from schemas.robot import LEGS
from schemas.telemetry import Telemetry
from tests.support.published import AT_REST, WALL
from tests.walking import physics

ROBOT: Final = Robot(load())
HALF: Final = 0.5
FALLEN_DEG: Final = 40.0

Forces = tuple[float, ...]
Sensor = Callable[[Forces], Forces]


def stuck(leg: int, force: float) -> Sensor:
    """Return sensors of which this leg's always reads this."""
    return lambda forces: tuple(force if each == leg else read for each, read in zip(LEGS, forces, strict=True))


def late(ticks: int = 5) -> Sensor:
    """Return sensors that are all 0.1 s late."""
    kept: deque[Forces] = deque(maxlen=ticks + 1)

    def sense(forces: Forces) -> Forces:
        kept.append(forces)
        return kept[0]

    return sense


SENSORS: Final[dict[str, Callable[[], Sensor]]] = {
    "without a fault": lambda: lambda forces: forces,
    "stuck on": lambda: stuck(3, 9.0),
    "stuck off": lambda: stuck(3, 0.0),
    "late": late,
}
TERRAINS: Final = {
    "flat": Terrain(),
    "slope 8 up": Terrain(slope_deg=8),
    "slope 15 up": Terrain(slope_deg=15),
    "step 20 mm": Terrain(step_m=0.02),
    "edge": Terrain(step_m=-0.15),
}


class Outcome(NamedTuple):
    """What became of the robot."""

    went_m: float
    tilt_deg: float
    """The mean of the body's tilt against gravity while it walked."""
    worst_deg: float
    limit: str


def measured(world: World, sensor: Sensor) -> Telemetry:
    """Return the body's truth as telemetry."""
    w, x, y, z = map(float, world.data.qpos[3:7])
    one, two, three, four, five, six = sensor(world.feet_n())
    values = AT_REST._replace(orientation_wxyz=(w, x, y, z), feet=(one, two, three, four, five, six))
    return report_of(values, WALL, 0.0)


def walk(terrain: str, sensor: Sensor | None, seconds: float = 12.0) -> Outcome:
    """Stand up and walk ahead by a tripod gait; without a sensor: blind."""
    sense = physics.blind if sensor is None else partial(measured, sensor=sensor)
    engine = Engine(ROBOT, "tripod")
    world = physics.stood_up(engine, Assumed(terrain=TERRAINS[terrain]), sense)
    physics.walk(world, engine, STILL, 1.5, sense)
    (begin_x_m, begin_y_m, _), tilts, limit = world.body().position_m, [], ""
    for _ in range(round(seconds / physics.TICK_S)):
        physics.walk(world, engine, Velocity(0.08), sense=sense)
        _, x, y, _ = map(float, world.data.qpos[3:7])
        tilts.append(math.degrees(math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y))))))  # against gravity
        limit = engine.limit or limit
        if tilts[-1] > FALLEN_DEG:
            break
    x_m, y_m, _ = world.body().position_m
    return Outcome(math.hypot(x_m - begin_x_m, y_m - begin_y_m), sum(tilts) / len(tilts), max(tilts), limit)


@cache
def blind(terrain: str) -> Outcome:
    return walk(terrain, None)


@pytest.mark.parametrize("terrain", ["slope 8 up", "slope 15 up", "step 20 mm"])
def test_on_uneven_ground_the_body_leans_at_most_half_as_much(terrain: str) -> None:
    feels = walk(terrain, SENSORS["without a fault"]())
    assert feels.worst_deg < FALLEN_DEG
    assert feels.tilt_deg <= HALF * blind(terrain).tilt_deg
    assert feels.went_m > 0.9 * blind(terrain).went_m


def test_on_a_flat_floor_it_goes_nine_tenths_as_far_as_blind() -> None:
    assert walk("flat", SENSORS["without a fault"](), 6.0).went_m >= 0.9 * walk("flat", None, 6.0).went_m


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_robot_stands_still_before_an_edge_that_a_blind_walk_goes_over(sensor: str) -> None:
    felt = walk("edge", SENSORS[sensor](), 6.0)
    assert "no ground under leg" in felt.limit
    assert felt.worst_deg < 5.0
