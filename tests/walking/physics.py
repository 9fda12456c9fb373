"""The robot on a plane, in MuJoCo (gateway/people/physics/world.py), driven by recorded frames.

What nobody has measured is assumed there; mass, force and friction are varied by 30 % (`VARIATIONS`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from gateway.geometry import Geometry, load
from gateway.geometry.model import MASSES
from gateway.model.frames import Op, decode
from gateway.people.physics.assumed import FRICTION, TORQUE_NM
from gateway.people.physics.assumed import Assumed as Assumptions
from gateway.people.physics.model import TIMESTEP_S
from gateway.people.physics.world import World as Simulated
from gateway.people.walking import STILL, Engine, Posture, Velocity
from schemas.robot import JOINTS
from schemas.telemetry import FrameRecord

TICK_S: Final = 0.02
LOOK_S: Final = 0.02
FALLEN_DEG: Final = 30.0
SUNK_M: Final = 0.092
"""The middle of a body with slack servos comes below this height. It stands at 0.154, and lies flat at 0.058.

Slack legs fold below it: tibias lie under one side, their femurs at their end stops, and hold that side up, while a
corner of the belly is on the ground. That corner is 0.236 m from the middle, which a lean of 8 degrees lifts by 0.03.
"""
SINKS_S: Final = 4.0
"""Slack legs brake it, and most of it is done in half a second; then it creeps into its last centimetre."""
_CARRIES: Final = 0.15
"""Of the robot's weight: a foot that carries less is being put down or lifted, and is not in its stance."""


class Assumed(NamedTuple):
    """Factors on what is assumed."""

    mass: float = 1.0
    force: float = 1.0
    friction: float = 1.0

    def __str__(self) -> str:
        words = [f"{name} {100 * (factor - 1):+.0f} %" for name, factor in self._asdict().items() if factor != 1]
        return ", ".join(words) or "as assumed"


VARIATIONS: Final = (
    Assumed(),
    Assumed(mass=0.7),
    Assumed(mass=1.3),
    Assumed(force=0.7),
    Assumed(force=1.3),
    Assumed(friction=0.7),
    Assumed(friction=1.3),
)


class Pose(NamedTuple):
    """Where the body is on the plane."""

    time_s: float
    x_m: float
    y_m: float
    height_m: float
    heading_rad: float
    """Counted on beyond half a turn."""
    tilt_deg: float


@dataclass
class Track:
    """What became of the robot while the frames ran."""

    poses: list[Pose] = field(default_factory=list)
    slips: list[tuple[float, float]] = field(default_factory=list)
    """When a foot that carries had gone how far (metres) over the ground in its stance."""

    @property
    def fell(self) -> bool:
        return any(pose.tilt_deg > FALLEN_DEG for pose in self.poses)

    def at(self, time_s: float) -> Pose:
        """The pose at that time (or at the end)."""
        return next((pose for pose in self.poses if pose.time_s >= time_s), self.poses[-1])

    def scraped_m(self, begin_s: float, end_s: float) -> float:
        """The furthest that a foot which carries went over the ground in one stance, between these times."""
        return max((slip_m for time_s, slip_m in self.slips if begin_s <= time_s <= end_s), default=0.0)

    def tilt_deg(self, begin_s: float, end_s: float) -> float:
        """The most between these times."""
        return max(pose.tilt_deg for pose in self.poses if begin_s <= pose.time_s <= end_s)


Sent = tuple[float, Mapping[int, float | None]]
"""When (seconds), and where servos are sent, in degrees; None: stopped."""


def sent_by(records: Sequence[FrameRecord], since_ns: int | None = None) -> list[Sent]:
    """What the frames say, in seconds since then, or since the first of them."""
    begun_ns = records[0].monotonic_ns if since_ns is None else since_ns
    found: list[Sent] = []
    for record in records:
        servos = decode(bytes.fromhex(record.bytes)).servos
        angles = {servo_id: None if op.op is Op.STOP else op.angle_cdeg / 100 for servo_id, op in servos}
        found.append(((record.monotonic_ns - begun_ns) / 1e9, angles))
    return found


def drive(world: Simulated, angles: Mapping[int, float | None], geometry: Geometry) -> None:
    """Send servos there, in angles of this geometry."""
    for servo_id, angle_deg in angles.items():
        world.drive(servo_id, None if angle_deg is None else geometry.joint_rad(servo_id, angle_deg))


def run(world: Simulated, seconds: float) -> None:
    """Simulate that long."""
    for _ in range(round(seconds / TIMESTEP_S)):
        world.step()


def walk(world: Simulated, engine: Engine, geometry: Geometry, wanted: Velocity, seconds: float = TICK_S) -> None:
    """As a gateway passes its setpoints on, 50 a second, and the time until the next."""
    for _ in range(round(seconds / TICK_S)):
        engine.step(wanted, TICK_S)
        drive(world, angles_of(engine), geometry)
        run(world, TICK_S)


def stand_up(world: Simulated, engine: Engine, geometry: Geometry) -> None:
    """By its walk, and half a second longer."""
    engine.stand()
    while engine.posture is not Posture.STANDING:
        walk(world, engine, geometry, STILL)
    walk(world, engine, geometry, STILL, 0.5)


def angles_of(engine: Engine) -> dict[int, float]:
    """Where it sends the legs that are not lost, in degrees as commands name them."""
    return {
        10 * leg + joint: angle_deg
        for leg, angles in engine.pose.items()
        for joint, angle_deg in zip(JOINTS, angles, strict=True)
    }


class World:
    """The robot of the default geometry, lying slack on its belly until its first frame."""

    def __init__(self, assumed: Assumed) -> None:
        self._geometry = load()
        self._world = Simulated(
            self._geometry,
            Assumptions(
                mass_kg=MASSES.total_kg * assumed.mass,
                torque_nm=TORQUE_NM * assumed.force,
                friction=FRICTION * assumed.friction,
            ),
        )
        self._carries_n = _CARRIES * 9.81 * float(sum(self._world.model.body_mass))
        self._stood: dict[int, Any] = {}
        self.track = Track()
        self._turned = 0.0

    def run(self, sent: Sequence[Sent]) -> Track:
        """Drive it by these, and a second longer. It begins with its legs where they will first be commanded to: where
        they lie is not known, and not the test."""
        world, geometry = self._world, self._geometry
        first: dict[int, float] = {}
        for _, angles in reversed(sent):
            first |= {
                servo_id: geometry.joint_rad(servo_id, deg) for servo_id, deg in angles.items() if deg is not None
            }
        world.lie_down(first)
        next_one, steps = 0, round(LOOK_S / TIMESTEP_S)
        end_s = sent[-1][0] + 1.0
        while world.time_s < end_s:
            for _ in range(steps):
                while next_one < len(sent) and sent[next_one][0] <= world.time_s:
                    drive(world, sent[next_one][1], geometry)
                    next_one += 1
                world.step()
            self._look()
        return self.track

    def _look(self) -> None:
        data = self._world.data
        body = data.body("base")
        turn, at = body.xmat.reshape(3, 3), body.xpos
        heading = math.atan2(turn[1, 0], turn[0, 0])
        self._turned += math.remainder(heading - self._turned, math.tau)
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, float(turn[2, 2])))))
        time_s = float(data.time)
        self.track.poses.append(Pose(time_s, float(at[0]), float(at[1]), float(at[2]), self._turned, tilt))
        self._look_at_feet()

    def _look_at_feet(self) -> None:
        """How far each foot that carries has gone over the ground since it began to."""
        world, data = self._world, self._world.data
        presses = dict.fromkeys(world.feet, 0.0)
        force = np.zeros(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            foot = next((geom for geom in (contact.geom1, contact.geom2) if geom in presses), None)
            if foot is not None:
                mujoco.mj_contactForce(world.model, data, number, force)
                presses[foot] += float(force[0])
        for foot, newtons in presses.items():
            at = data.geom_xpos[foot]
            if newtons > self._carries_n:
                begun = self._stood.setdefault(foot, at[:2].copy())
                self.track.slips.append((float(data.time), float(np.linalg.norm(at[:2] - begun))))
            else:
                self._stood.pop(foot, None)


def went(begin: Pose, end: Pose) -> tuple[float, float, float]:
    """Ahead, to the left (metres, as the robot saw it at the beginning), and turned (degrees)."""
    x_m, y_m = end.x_m - begin.x_m, end.y_m - begin.y_m
    cosine, sine = math.cos(begin.heading_rad), math.sin(begin.heading_rad)
    turned = math.degrees(end.heading_rad - begin.heading_rad)
    return cosine * x_m + sine * y_m, cosine * y_m - sine * x_m, turned
