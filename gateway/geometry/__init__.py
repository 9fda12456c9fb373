"""The shape of a robot: its joints, the relation of servo and joint angles, and a URDF.

One file (default: elkapod.json) has the numbers for the console, recordings and examples.
"""

from gateway.geometry.kinematics import FramePose, joint_name, transforms
from gateway.geometry.model import ELKAPOD, MAX_SPEED_DEG_S, Geometry, JointServo, load
from gateway.geometry.urdf import urdf

__all__ = [
    "ELKAPOD",
    "MAX_SPEED_DEG_S",
    "FramePose",
    "Geometry",
    "JointServo",
    "joint_name",
    "load",
    "transforms",
    "urdf",
]
