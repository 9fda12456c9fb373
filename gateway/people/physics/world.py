"""The robot on the ground in MuJoCo: its servos are driven, and it stands, walks or falls. Nothing here reads a clock.

The model is the geometry's URDF with 18 servos. A servo is a spring to its angle, as strong as its motor at most. Its
target goes no faster than its motor turns without load. A servo that is stopped is slack: only its bearings brake it.
Legs do not collide with each other.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from gateway.errors import ConfigError
from gateway.geometry import Geometry, joint_name, urdf
from gateway.geometry.kinematics import BASE, Quaternion, Vector, about, rotated
from gateway.geometry.model import TOTAL_KG
from gateway.host.shared_page import Sensed
from gateway.model.servo import NO_LOAD_DEG_S
from gateway.people.physics.assumed import TORQUE_NM, USUAL, Assumed, Terrain
from schemas.robot import LEGS, SERVO_IDS

_FRICTION_RATIO: Final = 10.0
"""MuJoCo's impratio: frictional against normal impedance of a contact. Walking robots' models have 10 to 100."""
TIMESTEP_S: Final = 0.002
_STIFFNESS_NM_RAD: Final = 50.0
"""The usual servo gives way by 2.3 degrees under its full load. A stronger one is as much stiffer; a weaker one is no
softer, and gives up sooner."""
_DAMPING_NMS_RAD: Final = 1.0
_ARMATURE_KGM2: Final = 0.01
_JOINT_DAMPING: Final = 0.02
_ROUGH_HALF_M: Final = 5.0
_ROUGH_CELLS: Final = 101
"""Bumps 10 cm apart, always the same ones; beyond these ten metres the ground is flat."""
_STEP_AT_M: Final = 0.45
"""A little ahead of the front feet at the start."""
_FLOOR, _ROBOT = 1, 2
"""MuJoCo's collision bits: each meets the other, and not itself."""


def built(geometry: Geometry, assumed: Assumed) -> Any:
    """Return the robot on its ground as an MjModel. Raises ConfigError if MuJoCo cannot simulate this geometry."""
    try:
        spec = mujoco.MjSpec.from_string(urdf(geometry))
        spec.compiler.fusestatic = False
        spec.body(BASE).add_freejoint()
        friction = [assumed.friction, 0.005, 0.0001]
        share = assumed.mass_kg / TOTAL_KG
        for body in spec.bodies:
            body.mass *= share
            body.inertia = body.inertia * share
            for geom in body.geoms:
                geom.contype, geom.conaffinity, geom.friction = _ROBOT, _FLOOR, friction
        _lay_ground(spec, assumed.terrain, friction)
        for servo_id in SERVO_IDS:
            _add_servo(spec, geometry, servo_id, max(1.0, assumed.torque_nm / TORQUE_NM))
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"MuJoCo cannot simulate {geometry.name}: {' '.join(str(error).split())}") from error
    model.actuator_forcelimited[:], model.dof_armature[6:] = 1, _ARMATURE_KGM2
    model.opt.timestep = TIMESTEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # With the default cone a foot that is loaded creeps over the ground, far below its limit of friction.
    model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _FRICTION_RATIO
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a divergence is reported first
    return model


def _lay_ground(spec: Any, terrain: Terrain, friction: list[float]) -> None:
    x, y, z, w = about((0, 1, 0), -math.radians(terrain.slope_deg))
    ground = {"friction": friction, "contype": _FLOOR, "conaffinity": _ROBOT, "quat": [w, x, y, z]}
    low_m, high_m = min(0.0, terrain.step_m), max(0.0, terrain.step_m)
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], pos=[0, 0, low_m], **ground
    )
    if terrain.step_m:
        half_m = (high_m - low_m) / 2
        x_m = _STEP_AT_M + math.copysign(_ROUGH_HALF_M, terrain.step_m)
        size, pos = [_ROUGH_HALF_M, _ROUGH_HALF_M, half_m], [x_m, 0, low_m + half_m]
        spec.worldbody.add_geom(name="step", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=pos, **ground)
    if terrain.rough_m:
        heights = np.random.default_rng(0).random(_ROUGH_CELLS**2)
        size = [_ROUGH_HALF_M, _ROUGH_HALF_M, terrain.rough_m, 0.05]
        spec.add_hfield(name="bumps", size=size, nrow=_ROUGH_CELLS, ncol=_ROUGH_CELLS, userdata=heights)
        spec.worldbody.add_geom(name="bumps", type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="bumps", **ground)


def _add_servo(spec: Any, geometry: Geometry, servo_id: int, stiffer: float) -> None:
    name = joint_name(servo_id)
    joint = spec.joint(name)
    joint.damping[0] = _JOINT_DAMPING
    joint.range = sorted(geometry.joint_rad(servo_id, end_deg) for end_deg in (0.0, 180.0))  # a horn ends at its stops
    joint.actfrclimited = False  # MuJoCo takes the URDF's effort for the joint's limit, whatever the servo is
    stiffness, damping = _STIFFNESS_NM_RAD * stiffer, _DAMPING_NMS_RAD * stiffer
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gainprm[0], servo.biastype = stiffness, mujoco.mjtBias.mjBIAS_AFFINE
    servo.biasprm[1:3] = -stiffness, -damping


FALLEN_DEG: Final = 45.0
"""A body that leans further against the ground no longer stands on its feet."""
_STEP_RAD: Final = math.radians(NO_LOAD_DEG_S) * TIMESTEP_S
_DROP_M: Final = 0.02
"""Height of slack legs above the ground at the start."""
_FREE: Final = 7
"""The first positions are the body's: x, y, z and a quaternion (w first)."""
_ABSURD: Final = 1000.0
"""m/s or rad/s. A servo turns at 6 rad/s, and a robot that falls off a table hits the floor at 4 m/s."""
_DEEP_M: Final = 0.002
_END_M: Final = 0.03
"""Contacts this near to the tip of a leg are the foot's."""


mujoco.set_mju_user_warning(lambda _: None)  # `fault` reports it; MuJoCo would write a file to the working directory


class Body(NamedTuple):
    """Where the robot is, in the world's frame: x forward, y left, z up; the ground is at z = 0 where it begins."""

    position_m: Vector
    rotation: Quaternion
    velocity_m_s: Vector
    tilt_deg: float
    """Tilt against the ground, which may be a slope."""
    feet: tuple[bool, bool, bool, bool, bool, bool]
    """By leg (1 to 6), whether the foot touches the ground."""
    joints_rad: dict[int, float]
    torques_nm: dict[int, float]

    @property
    def upright(self) -> bool:
        """Whether the robot has not fallen over."""
        return self.tilt_deg <= FALLEN_DEG


class World:
    """The robot, lying slack on its belly at first."""

    def __init__(self, geometry: Geometry, assumed: Assumed = USUAL) -> None:
        """Raises ConfigError if MuJoCo cannot simulate the robot."""
        self.model: Any = built(geometry, assumed)
        self.data: Any = mujoco.MjData(self.model)
        self.feet: dict[int, int] = {}
        """The leg of each geom that touches the ground: the solid sphere of a foot."""
        for leg in LEGS:
            solid = np.flatnonzero(self.model.geom_bodyid == self.model.body(f"leg_{leg}_foot").id)
            self.feet[int(min(solid, key=lambda geom: float(self.model.geom_size[geom][0])))] = leg
        self._torque_nm = assumed.torque_nm
        self._level = about((0, 1, 0), -math.radians(assumed.terrain.slope_deg))
        self._up = rotated(self._level, (0, 0, 1))
        self._bumps_m = assumed.terrain.rough_m
        self._robot = np.flatnonzero(self.model.geom_bodyid)
        self._places = {servo_id: place for place, servo_id in enumerate(SERVO_IDS)}
        self._wanted_rad = np.zeros(len(SERVO_IDS))
        self._kept: Any = None
        """The positions at the last call of `fault`, if they were valid."""
        self.lie_down({})

    @property
    def time_s(self) -> float:
        """Simulated time in seconds."""
        return float(self.data.time)

    def drive(self, servo_id: int, joint_rad: float | None) -> None:
        """Send a servo to this angle of its joint, and start it if it is stopped; None: stop it."""
        place = self._places[servo_id]
        if joint_rad is None:
            self.model.actuator_forcerange[place] = 0.0, 0.0
            return
        if not self.model.actuator_forcerange[place][1]:
            self.model.actuator_forcerange[place] = -self._torque_nm, self._torque_nm
            self.data.ctrl[place] = self.data.qpos[_FREE + place]
        self._wanted_rad[place] = joint_rad

    def step(self) -> None:
        """Simulate the next TIMESTEP_S."""
        self.data.ctrl += np.clip(self._wanted_rad - self.data.ctrl, -_STEP_RAD, _STEP_RAD)
        mujoco.mj_step(self.model, self.data)

    def lie_down(self, joints_rad: Mapping[int, float]) -> None:
        """Put the robot at its start: upright, at rest, slack, a little above the ground, with these joint angles."""
        time_s = self.time_s
        mujoco.mj_resetData(self.model, self.data)
        self.data.time = time_s
        for servo_id in SERVO_IDS:
            self.drive(servo_id, None)
            self.data.qpos[_FREE + self._places[servo_id]] = joints_rad.get(servo_id, 0.0)
        self._stand_at(0.0, 0.0)

    def set_upright(self) -> None:
        """Put the robot on its feet where it is, as by hand. Legs and servos keep their state."""
        self._stand_at(float(self.data.qpos[0]), float(self.data.qpos[1]))

    def body(self) -> Body:
        """Return the body's present pose and velocity."""
        data = self.data
        w, *axis = map(float, data.qpos[3:_FREE])
        rotation = axis[0], axis[1], axis[2], w
        # Lower ends of legs: the box of a leaning tibia is lower than its tip.
        one, two, three, four, five, six = map(bool, self._at_feet().any(axis=1))
        lean = sum(a * b for a, b in zip(rotated(rotation, (0, 0, 1)), self._up, strict=True))
        return Body(
            position_m=vector(data.qpos[:3]),
            rotation=rotation,
            velocity_m_s=vector(data.qvel[:3]),
            tilt_deg=math.degrees(math.acos(max(-1.0, min(1.0, lean)))),
            feet=(one, two, three, four, five, six),
            joints_rad=dict(zip(SERVO_IDS, map(float, data.qpos[_FREE:]), strict=True)),
            torques_nm=dict(zip(SERVO_IDS, map(float, data.actuator_force), strict=True)),
        )

    def feet_n(self) -> tuple[float, ...]:
        """Return the force (N) of the ground on each of the six feet, perpendicular to the ground."""
        pushes_n, force = np.zeros(self.data.ncon), np.zeros(6)
        for number in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, number, force)
            pushes_n[number] = force[0]
        return tuple(map(float, self._at_feet() @ pushes_n))

    def overlap(self) -> str | None:
        """Return a sentence about legs that are inside each other: nothing keeps the legs of a model apart."""
        legs = [sentence for _, sentence in sorted(self._depths()) if sentence.count("leg") > 1]
        return f"{legs[-1]}: look at its geometry" if legs else None

    def fault(self) -> str | None:
        """Return why the simulation since the last call is invalid, in a sentence. Then the robot lies at its start."""
        speeds = np.abs(self.data.qvel)
        if np.all(np.isfinite(self.data.qpos)) and np.all(speeds < _ABSURD):
            self._kept = self.data.qpos.copy()
            return None
        worst, fast = int(np.argmax(speeds)) - _FREE + 1, ""
        if worst >= 0 and np.all(np.isfinite(speeds)):
            fast = f": joint {SERVO_IDS[worst]} turned at {speeds.max():.0f} rad/s"
        if self._kept is not None:
            self.data.qpos[:] = self._kept
        _, inside = max(self._depths(), default=(0.0, ""))
        self.lie_down({} if self._kept is None else dict(zip(SERVO_IDS, self._kept[_FREE:], strict=True)))
        return (
            f"the simulation exploded after {self.time_s:.1f} s{fast}{inside and f'; {inside}'}. The robot lies down "
            "anew; look at its geometry, mass and torque"
        )

    def _stand_at(self, x_m: float, y_m: float) -> None:
        """Put the body level with the ground, at rest, a little above it."""
        data = self.data
        x, y, z, w = self._level
        data.qpos[:_FREE] = x_m, y_m, 0.0, w, x, y, z
        data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, data)
        sizes = self.model.geom_size  # half the shortest side of a box, or the radius of a sphere
        lowest_m = min(
            float(np.dot(data.geom_xpos[geom], self._up) - sizes[geom][sizes[geom] > 0].min()) for geom in self._robot
        )
        data.qpos[2] += (self._bumps_m + _DROP_M - lowest_m) / self._up[2]
        mujoco.mj_forward(self.model, data)

    def _at_feet(self) -> Any:
        """Return a matrix of booleans: for each of the six feet, the contacts near its tip."""
        tips_m, contacts_m = self.data.geom_xpos[list(self.feet)], self.data.contact.pos
        return np.linalg.norm(tips_m[:, np.newaxis] - contacts_m, axis=2) < _END_M

    def _depths(self) -> Iterator[tuple[float, str]]:
        """Yield how deep (m) parts are in others or the ground, and a sentence. Parts of one leg may overlap."""
        model = self.model
        types = model.geom_contype.copy(), model.body_contype.copy()
        model.geom_contype[:] = model.body_contype[:] = 3  # each other, too
        mujoco.mj_forward(model, self.data)
        model.geom_contype[:], model.body_contype[:] = types
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            first, second = map(self._owner, contact.geom)
            if contact.dist < -_DEEP_M and first != second:
                yield -contact.dist, f"{first} is in {second} {-1000 * contact.dist:.0f} mm deep"

    def _owner(self, geom: int) -> str:
        name = self.model.body(self.model.geom_bodyid[geom]).name
        if name == "world":
            return "the ground"
        return f"leg {name.split('_')[1]}" if name.startswith("leg_") else "the body"


class Sensors:
    """An IMU in the middle of the body, a force sensor in each foot, and the torque of each servo."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._time_s = world.time_s
        self._velocity_m_s: Any = world.data.qvel[:3].copy()
        self._felt_m_s2: Any = -world.model.opt.gravity
        """Acceleration in the world's frame; a body at rest is supported against gravity."""

    def read(self) -> Sensed:
        """Return what the sensors measure. The acceleration is the mean since the last call, as an IMU filters it."""
        world, data = self._world, self._world.data
        passed_s = world.time_s - self._time_s
        if passed_s > 0:
            velocity_m_s = data.qvel[:3].copy()
            self._felt_m_s2 = (velocity_m_s - self._velocity_m_s) / passed_s - world.model.opt.gravity
            self._time_s, self._velocity_m_s = world.time_s, velocity_m_s
        w, x, y, z = map(float, data.qpos[3:7])
        return Sensed(
            orientation_wxyz=(w, x, y, z),
            angular_velocity_rad_s=vector(data.qvel[3:6]),
            linear_acceleration_m_s2=rotated((-x, -y, -z, w), vector(self._felt_m_s2)),
            feet_n=world.feet_n(),
            torques_nm=tuple(map(float, data.actuator_force)),
        )


def vector(values: Any) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
