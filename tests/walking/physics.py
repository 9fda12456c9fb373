"""The robot on a plane, in MuJoCo: the URDF that the gateway writes, servos driven by recorded frames.

Assumed, since nobody has measured the Elkapod: the masses (gateway/geometry/masses.py), a tip of the foot of 5 mm
(gateway/geometry/urdf.py), and below a servo of 20 kg·cm that gives way by 2.3 degrees for that, and rubber on wood.
Mass, force and friction are varied by 30 % (`VARIATIONS`). A servo that is stopped is slack. Legs do not collide with
each other.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from gateway.geometry import Geometry, joint_name, load, urdf
from gateway.robot.protocol.frames import Op, decode
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import FrameRecord

FORCE_NM: Final = 2.0
STIFFNESS_NM_RAD: Final = 50.0
DAMPING_NMS_RAD: Final = 1.0
FRICTION: Final = 0.8
TIMESTEP_S: Final = 0.002
_ARMATURE_KGM2: Final = 0.01
_JOINT_DAMPING: Final = 0.02
LOOK_S: Final = 0.02
FALLEN_DEG: Final = 30.0
_CARRIES: Final = 0.15
"""Of the robot's weight: a foot that carries less is being put down or lifted, and is not in its stance."""
_DROP_M: Final = 0.02
"""Slack legs, a little above the ground."""


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


class Setpoint(NamedTuple):
    """One servo at one time; no angle: stopped."""

    time_s: float
    servo_id: int
    joint_rad: float | None


def setpoints(records: Sequence[FrameRecord], geometry: Geometry) -> list[Setpoint]:
    """What the frames say to the servos, in seconds since the first; the wire's angles are the default geometry's."""
    found = []
    begun_ns = records[0].monotonic_ns
    for record in records:
        time_s = (record.monotonic_ns - begun_ns) / 1e9
        for servo_id, op in decode(bytes.fromhex(record.bytes)).servos:
            joint_rad = None if op.op is Op.STOP else geometry.joint_rad(servo_id, op.angle_cdeg / 100)
            found.append(Setpoint(time_s, servo_id, joint_rad))
    return sorted(found, key=lambda each: each.time_s)


class World:
    """The robot, lying slack on its belly until its first setpoint."""

    def __init__(self, assumed: Assumed = Assumed(), geometry: Geometry | None = None) -> None:  # noqa: B008
        self._geometry = geometry or load()
        self._force_nm = FORCE_NM * assumed.force
        self.model: Any = self._built(assumed)
        self.data: Any = mujoco.MjData(self.model)
        self._actuators = {servo_id: self.model.actuator(joint_name(servo_id)).id for servo_id in SERVO_IDS}
        self._floor = self.model.geom("floor").id
        self._feet = {self._tip(leg): leg for leg in LEGS}
        self._stood: dict[int, Any] = {}
        self._weight_n = float(sum(self.model.body_mass)) * 9.81
        self.track = Track()
        self._turned = 0.0

    def run(self, wanted: Sequence[Setpoint], more_s: float = 1.0) -> Track:
        """Drive it by these, and a second longer."""
        self._lay_down(wanted)
        next_one, steps = 0, round(LOOK_S / TIMESTEP_S)
        end_s = wanted[-1].time_s + more_s
        while self.data.time < end_s:
            for _ in range(steps):
                while next_one < len(wanted) and wanted[next_one].time_s <= self.data.time:
                    self._drive(wanted[next_one])
                    next_one += 1
                mujoco.mj_step(self.model, self.data)
            self._look()
        return self.track

    def _lay_down(self, wanted: Sequence[Setpoint]) -> None:
        """Its legs hang where they will first be commanded to: where they lie is not known, and not the test."""
        first: dict[int, float] = {}
        for each in wanted:
            if each.joint_rad is not None:
                first.setdefault(each.servo_id, each.joint_rad)
        for servo_id, joint_rad in first.items():
            self.data.joint(joint_name(servo_id)).qpos = joint_rad
        for servo_id in SERVO_IDS:
            self._drive(Setpoint(0.0, servo_id, None))
        mujoco.mj_forward(self.model, self.data)
        lowest_m = min(float(self.data.geom_xpos[geom][2]) for geom in range(self.model.ngeom) if geom != self._floor)
        self.data.qpos[2] += _DROP_M + max(0.03, -lowest_m)

    def _drive(self, wanted: Setpoint) -> None:
        actuator = self._actuators[wanted.servo_id]
        force_nm = 0.0 if wanted.joint_rad is None else self._force_nm
        self.model.actuator_forcerange[actuator] = -force_nm, force_nm
        if wanted.joint_rad is not None:
            self.data.ctrl[actuator] = wanted.joint_rad

    def _look(self) -> None:
        body = self.data.body("base")
        turn, at = body.xmat.reshape(3, 3), body.xpos
        heading = math.atan2(turn[1, 0], turn[0, 0])
        self._turned += math.remainder(heading - self._turned, math.tau)
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, float(turn[2, 2])))))
        time_s = float(self.data.time)
        self.track.poses.append(Pose(time_s, float(at[0]), float(at[1]), float(at[2]), self._turned, tilt))
        self._look_at_feet()

    def _look_at_feet(self) -> None:
        """How far each foot that carries has gone over the ground since it began to."""
        presses = dict.fromkeys(self._feet, 0.0)
        force = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            foot = next((geom for geom in (contact.geom1, contact.geom2) if geom in presses), None)
            if foot is not None:
                mujoco.mj_contactForce(self.model, self.data, number, force)
                presses[foot] += float(force[0])
        for foot, newtons in presses.items():
            at = self.data.geom_xpos[foot]
            if newtons > _CARRIES * self._weight_n:
                begun = self._stood.setdefault(foot, at[:2].copy())
                self.track.slips.append((float(self.data.time), float(np.linalg.norm(at[:2] - begun))))
            else:
                self._stood.pop(foot, None)

    def _radius(self, geom: int) -> float:
        return float(self.model.geom_size[geom][0])

    def _tip(self, leg: int) -> int:
        """The solid sphere of a foot."""
        body = self.model.body(f"leg_{leg}_foot").id
        solid = [geom for geom in range(self.model.ngeom) if self.model.geom_bodyid[geom] == body]
        return int(min(solid, key=self._radius))

    def _built(self, assumed: Assumed) -> Any:
        spec = mujoco.MjSpec.from_string(urdf(self._geometry))
        spec.compiler.fusestatic = False
        spec.body("base").add_freejoint()
        friction = [FRICTION * assumed.friction, 0.005, 0.0001]
        for body in spec.bodies:
            body.mass *= assumed.mass
            body.inertia = body.inertia * assumed.mass
            for geom in body.geoms:
                geom.contype, geom.conaffinity, geom.friction = 2, 1, friction
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(
            name="floor", type=plane, size=[0, 0, 0.05], friction=friction, contype=1, conaffinity=2
        )
        for servo_id in SERVO_IDS:
            name = joint_name(servo_id)
            spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        model = spec.compile()
        model.opt.timestep = TIMESTEP_S
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        model.dof_damping[6:] = _JOINT_DAMPING
        model.dof_armature[6:] = _ARMATURE_KGM2
        model.jnt_limited[:] = 0
        # A servo is a spring to its angle, as strong as its motor at most.
        model.actuator_gaintype[:] = mujoco.mjtGain.mjGAIN_FIXED
        model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_gainprm[:] = 0
        model.actuator_biasprm[:] = 0
        model.actuator_gainprm[:, 0] = STIFFNESS_NM_RAD
        model.actuator_biasprm[:, 1] = -STIFFNESS_NM_RAD
        model.actuator_biasprm[:, 2] = -DAMPING_NMS_RAD
        model.actuator_forcelimited[:] = 1
        return model


def went(begin: Pose, end: Pose) -> tuple[float, float, float]:
    """Ahead, to the left (metres, as the robot saw it at the beginning), and turned (degrees)."""
    x_m, y_m = end.x_m - begin.x_m, end.y_m - begin.y_m
    cosine, sine = math.cos(begin.heading_rad), math.sin(begin.heading_rad)
    turned = math.degrees(end.heading_rad - begin.heading_rad)
    return cosine * x_m + sine * y_m, cosine * y_m - sine * x_m, turned
