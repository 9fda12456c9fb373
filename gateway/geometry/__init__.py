"""The shape of a robot: where its joints are, which servo angle is which joint angle, and a URDF of it all.

One file has the numbers (elkapod.json is the default); the console, recordings and examples read it here.
"""

from gateway.geometry.kinematics import Transform, foot_m, joint_name, transforms
from gateway.geometry.model import ELKAPOD, MAX_SPEED_DEG_S, Geometry, JointServo, load
from gateway.geometry.urdf import urdf

__all__ = [
    "ELKAPOD",
    "MAX_SPEED_DEG_S",
    "Geometry",
    "JointServo",
    "Transform",
    "foot_m",
    "joint_name",
    "load",
    "transforms",
    "urdf",
]
