"""The robot on the ground, in MuJoCo: the geometry's URDF with 18 servos. Time is what `step` adds; nothing here waits.

A servo is a spring to its angle, as strong as its motor at most, and its target goes no faster than its motor turns
without load. A servo that is stopped is slack: only its bearings brake it. Legs do not collide with each other.
"""

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from gateway.geometry import Geometry, joint_name, urdf
from gateway.geometry.masses import MASSES
from gateway.robot.spi.simulator import MAX_SPEED_DEG_S
from schemas.robot import LEGS, SERVO_IDS

TORQUE_NM: Final = 2.0
"""A servo of 20 kg·cm, the usual one in robots of this size. (An MG996R has 9.4 kg·cm at 4.8 V.)"""
FRICTION: Final = 0.8
"""Rubber on wood; the Elkapod's own simulation has the same for its feet."""
TIMESTEP_S: Final = 0.002
_STIFFNESS_NM_RAD: Final = 50.0
"""It gives way by 2.3 degrees under its full load."""
_DAMPING_NMS_RAD: Final = 1.0
_ARMATURE_KGM2: Final = 0.01
_JOINT_DAMPING: Final = 0.02
_STEP_RAD: Final = math.radians(MAX_SPEED_DEG_S) * TIMESTEP_S
_DROP_M: Final = 0.02
"""Slack legs, a little above the ground."""
_LEAST_HEIGHT_M: Final = 0.03
_FREE: Final = 7
"""Of the positions, the first belong to the body: x, y, z and a quaternion (w first)."""


class Assumed(NamedTuple):
    """What nobody has measured on the robot."""

    mass_kg: float = MASSES.total_kg
    """Of the whole robot; its parts keep their shares."""
    torque_nm: float = TORQUE_NM
    friction: float = FRICTION


class World:
    """The robot, lying slack on its belly at first."""

    def __init__(self, geometry: Geometry, assumed: Assumed = Assumed()) -> None:  # noqa: B008
        self._geometry = geometry
        self._torque_nm = assumed.torque_nm
        self.model: Any = _built(geometry, assumed)
        self.data: Any = mujoco.MjData(self.model)
        self.weight_n = float(sum(self.model.body_mass)) * 9.81
        self.floor = self.model.geom("floor").id
        self.feet = {self._tip(leg): leg for leg in LEGS}
        """The geom that touches the ground: which leg's it is."""
        self._places = {servo_id: place for place, servo_id in enumerate(SERVO_IDS)}
        self._wanted_rad = np.zeros(len(SERVO_IDS))
        self.lie_down({})

    @property
    def time_s(self) -> float:
        """How long it has been simulated."""
        return float(self.data.time)

    def drive(self, servo_id: int, joint_rad: float | None) -> None:
        """Send a servo to an angle of its joint, starting it if need be; None: stop it."""
        place = self._places[servo_id]
        runs = bool(self.model.actuator_forcerange[place][1])
        if joint_rad is None:
            self.model.actuator_forcerange[place] = 0.0, 0.0
            return
        if not runs:
            self.model.actuator_forcerange[place] = -self._torque_nm, self._torque_nm
            self.data.ctrl[place] = self.data.qpos[_FREE + place]
        self._wanted_rad[place] = joint_rad

    def step(self) -> None:
        """Simulate TIMESTEP_S more."""
        self.data.ctrl += np.clip(self._wanted_rad - self.data.ctrl, -_STEP_RAD, _STEP_RAD)
        mujoco.mj_step(self.model, self.data)

    def lie_down(self, joints_rad: Mapping[int, float]) -> None:
        """Upright and at rest, a little above the ground, slack, with its joints at these angles."""
        mujoco.mj_resetData(self.model, self.data)
        for servo_id, joint_rad in joints_rad.items():
            self.data.qpos[_FREE + self._places[servo_id]] = joint_rad
        for servo_id in SERVO_IDS:
            self.drive(servo_id, None)
        mujoco.mj_forward(self.model, self.data)
        lowest_m = min(float(self.data.geom_xpos[geom][2]) for geom in range(self.model.ngeom) if geom != self.floor)
        self.data.qpos[2] += _DROP_M + max(_LEAST_HEIGHT_M, -lowest_m)

    def _tip(self, leg: int) -> int:
        """The solid sphere of a foot."""
        body = self.model.body(f"leg_{leg}_foot").id
        solid = [geom for geom in range(self.model.ngeom) if self.model.geom_bodyid[geom] == body]
        return int(min(solid, key=lambda geom: float(self.model.geom_size[geom][0])))


def _built(geometry: Geometry, assumed: Assumed) -> Any:
    spec = mujoco.MjSpec.from_string(urdf(geometry))
    spec.compiler.fusestatic = False
    spec.body("base").add_freejoint()
    friction = [assumed.friction, 0.005, 0.0001]
    share = assumed.mass_kg / MASSES.total_kg
    for body in spec.bodies:
        body.mass *= share
        body.inertia = body.inertia * share
        for geom in body.geoms:
            geom.contype, geom.conaffinity, geom.friction = 2, 1, friction
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 0.05], friction=friction, contype=1, conaffinity=2)
    for servo_id in SERVO_IDS:
        name = joint_name(servo_id)
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    model = spec.compile()
    model.opt.timestep = TIMESTEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_damping[6:] = _JOINT_DAMPING
    model.dof_armature[6:] = _ARMATURE_KGM2
    for servo_id in SERVO_IDS:  # a horn ends at its stops
        joint = model.joint(joint_name(servo_id))
        joint.range[:] = sorted(geometry.joint_rad(servo_id, end_deg) for end_deg in (0.0, 180.0))
    model.jnt_limited[1:] = 1
    model.actuator_gaintype[:] = mujoco.mjtGain.mjGAIN_FIXED
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[:] = 0
    model.actuator_biasprm[:] = 0
    model.actuator_gainprm[:, 0] = _STIFFNESS_NM_RAD
    model.actuator_biasprm[:, 1] = -_STIFFNESS_NM_RAD
    model.actuator_biasprm[:, 2] = -_DAMPING_NMS_RAD
    model.actuator_forcelimited[:] = 1
    return model
