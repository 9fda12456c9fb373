"""A walk over uneven ground in MuJoCo, with the body's truth as its telemetry; sensors may be faulty."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from gateway.geometry import load
from gateway.people.physics.assumed import Assumed, Terrain
from gateway.people.physics.world import World
from gateway.people.walking import STILL, Engine, Posture, Robot, Velocity
from schemas.robot import LEGS
from schemas.telemetry import Imu, Telemetry
from tests.walking.physics import TICK_S, angles_of, drive, run

GEOMETRY: Final = load()
ROBOT: Final = Robot(GEOMETRY)
FALLEN_DEG: Final = 40.0
_NOW: Final = datetime(2026, 1, 1, tzinfo=UTC)
Forces = tuple[float, ...]
Sensor = Callable[[Forces], Forces]


def true(forces: Forces) -> Forces:
    """Sensors without a fault."""
    return forces


def stuck(leg: int, force: float) -> Sensor:
    """The sensor of this leg always reads this."""
    return lambda forces: tuple(force if each == leg else read for each, read in zip(LEGS, forces, strict=True))


def late(ticks: int = 5) -> Sensor:
    """All of them are 0.1 s late."""
    kept: deque[Forces] = deque(maxlen=ticks + 1)

    def sense(forces: Forces) -> Forces:
        kept.append(forces)
        return kept[0]

    return sense


class Course(NamedTuple):
    """A way over a terrain."""

    terrain: Terrain
    velocity: Velocity = Velocity(0.08)
    seconds: float = 12.0
    gait: str = "tripod"
    push_n: float = 0.0
    """To the left, for 0.2 s in the middle of it."""
    lift_n: float = 0.0
    """Upward, from the middle of it on."""


class Outcome(NamedTuple):
    """What became of the robot."""

    went_m: float
    tilt_deg: float
    """The mean of the body's tilt against gravity while it walked."""
    worst_deg: float
    fell: bool
    limit: str


def measured(world: World, sensor: Sensor) -> Telemetry:
    """The body's truth as telemetry."""
    w, x, y, z = map(float, world.data.qpos[3:7])
    presses = dict.fromkeys(LEGS, 0.0)
    force: Any = np.zeros(6)
    positions = np.array([world.data.geom_xpos[geom] for geom in world.feet])
    legs = list(world.feet.values())
    for number in range(world.data.ncon):
        away = np.linalg.norm(positions - world.data.contact[number].pos, axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] < 0.03:
            mujoco.mj_contactForce(world.model, world.data, number, force)
            presses[legs[nearest]] += float(force[0])
    one, two, three, four, five, six = sensor(tuple(presses[leg] for leg in LEGS))
    still = (0.0, 0.0, 0.0)
    return Telemetry(
        time=_NOW,
        age_ms=0.0,
        imu=Imu(orientation_wxyz=(w, x, y, z), angular_velocity_rad_s=still, linear_acceleration_m_s2=still),
        feet=(one, two, three, four, five, six),
    )


def walk(course: Course, *, adapts: bool, sensor: Sensor = true) -> Outcome:
    """Stand up and walk the course."""
    engine, world = Engine(ROBOT, course.gait), World(GEOMETRY, Assumed(terrain=course.terrain))
    world.lie_down({servo_id: GEOMETRY.joint_rad(servo_id, deg) for servo_id, deg in angles_of(engine).items()})

    def tick(wanted: Velocity) -> float:
        engine.step(wanted, TICK_S, measured(world, sensor) if adapts else None)
        drive(world, angles_of(engine), GEOMETRY)
        run(world, TICK_S)
        _, x, y, _ = map(float, world.data.qpos[3:7])
        return math.degrees(math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y)))))

    engine.stand()
    while engine.posture is not Posture.STANDING:
        tick(STILL)
    for _ in range(round(2.0 / TICK_S)):
        tick(STILL)
    begun, tilts, limit = world.body().position_m, [], ""
    ticks = round(course.seconds / TICK_S)
    for number in range(ticks):
        pushed = ticks // 2 <= number < ticks // 2 + 10
        world.data.body("base").xfrc_applied[1] = course.push_n if pushed else 0.0
        world.data.body("base").xfrc_applied[2] = course.lift_n if number >= ticks // 2 else 0.0
        tilts.append(tick(course.velocity))
        limit = engine.limit or limit
        if tilts[-1] > FALLEN_DEG:
            break
    went_m = math.dist(world.body().position_m[:2], begun[:2])
    worst = max(tilts)
    return Outcome(went_m, sum(tilts) / len(tilts), worst, worst > FALLEN_DEG, limit)


COURSES: Final[dict[str, Course]] = {
    "flat": Course(Terrain()),
    **{f"slope {deg:g} up": Course(Terrain(slope_deg=deg)) for deg in (8, 15)},
    "slope 15 down": Course(Terrain(slope_deg=-15)),
    "slope 15 across": Course(Terrain(slope_deg=15), Velocity(0, 0.06)),
    **{f"step {mm} mm": Course(Terrain(step_m=mm / 1000)) for mm in (10, 20, 30)},
    "kerb 30 mm down": Course(Terrain(step_m=-0.03)),
    "edge": Course(Terrain(step_m=-0.15)),
    **{f"stones {seed} ahead": Course(Terrain(rough_m=0.025, seed=seed)) for seed in range(3)},
    "stones 0 to the left": Course(Terrain(rough_m=0.025), Velocity(0, 0.06)),
    "stones 0 back": Course(Terrain(rough_m=0.025), Velocity(-0.08)),
    "push": Course(Terrain(), push_n=40.0),
}
SENSORS: Final[dict[str, Callable[[], Sensor]]] = {
    "stuck on": lambda: stuck(3, 9.0),
    "stuck off": lambda: stuck(3, 0.0),
    "late": late,
}


def row(name: str, outcomes: Sequence[Outcome]) -> str:
    """A line of the table: blind, adapting, and with each faulty sensor."""
    return f"{name:20}" + "".join(
        f"  {each.went_m:5.2f}m {each.tilt_deg:4.1f}/{each.worst_deg:4.1f}°{' FELL' if each.fell else '     '}"
        for each in outcomes
    )
