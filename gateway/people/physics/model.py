"""MuJoCo's model of the robot on the ground: the geometry's URDF with 18 servos.

A servo is a spring to its angle, as strong as its motor at most. Legs do not collide with each other.
"""

import math
from typing import Any, Final

import mujoco
import numpy as np

from gateway.errors import ConfigError
from gateway.geometry import Geometry, joint_name, urdf
from gateway.geometry.kinematics import BASE, about
from gateway.geometry.model import MASSES
from gateway.people.physics.assumed import TORQUE_NM, Assumed, Terrain
from schemas.robot import SERVO_IDS

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
"""Bumps 10 cm apart, of each seed always the same ones; beyond these ten metres the ground is flat."""
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
        _weigh_and_cover(spec, assumed.mass_kg / MASSES.total_kg, friction)
        _lay_ground(spec, assumed.terrain, friction)
        for servo_id in SERVO_IDS:
            name = joint_name(servo_id)
            spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"MuJoCo cannot simulate {geometry.name}: {' '.join(str(error).split())}") from error
    _set_up_servos(model, geometry, max(1.0, assumed.torque_nm / TORQUE_NM))
    model.opt.timestep = TIMESTEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # With the default cone a foot that is loaded creeps over the ground, far below its limit of friction.
    model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _FRICTION_RATIO
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a divergence is reported first
    return model


def _weigh_and_cover(spec: Any, share: float, friction: list[float]) -> None:
    for body in spec.bodies:
        body.mass *= share
        body.inertia = body.inertia * share
        for geom in body.geoms:
            geom.contype, geom.conaffinity, geom.friction = _ROBOT, _FLOOR, friction


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
        heights = np.random.default_rng(terrain.seed).random(_ROUGH_CELLS**2)
        size = [_ROUGH_HALF_M, _ROUGH_HALF_M, terrain.rough_m, 0.05]
        spec.add_hfield(name="bumps", size=size, nrow=_ROUGH_CELLS, ncol=_ROUGH_CELLS, userdata=heights)
        spec.worldbody.add_geom(name="bumps", type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="bumps", **ground)


def _set_up_servos(model: Any, geometry: Geometry, stiffer: float) -> None:
    model.dof_damping[6:] = _JOINT_DAMPING
    model.dof_armature[6:] = _ARMATURE_KGM2
    for servo_id in SERVO_IDS:  # a horn ends at its stops
        ends_rad = sorted(geometry.joint_rad(servo_id, end_deg) for end_deg in (0.0, 180.0))
        model.joint(joint_name(servo_id)).range[:] = ends_rad
    model.jnt_limited[1:] = 1
    model.jnt_actfrclimited[:] = 0  # MuJoCo takes the URDF's effort for the joint's limit, whatever the servo is
    model.actuator_gaintype[:] = mujoco.mjtGain.mjGAIN_FIXED
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[:] = 0
    model.actuator_biasprm[:] = 0
    model.actuator_gainprm[:, 0] = _STIFFNESS_NM_RAD * stiffer
    model.actuator_biasprm[:, 1] = -_STIFFNESS_NM_RAD * stiffer
    model.actuator_biasprm[:, 2] = -_DAMPING_NMS_RAD * stiffer
    model.actuator_forcelimited[:] = 1
