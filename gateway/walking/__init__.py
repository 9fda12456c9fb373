"""Walking: body velocities in, servo angles out. Pure: time is an argument, and nothing here reads or sends.

`Walker` is what a program, a console or a bridge drives; it stops by itself when its driver falls silent. `Engine` is
the gait below it, `Robot` where the feet can be.
"""

from gateway.walking.engine import Engine, Odometry, Posture
from gateway.walking.gaits import GAITS, Gait
from gateway.walking.motion import STILL, Body, Velocity
from gateway.walking.robot import Pose, Range, Robot, Stance
from gateway.walking.walker import HOLD_S, REST_S, Walker, WalkState

__all__ = [
    "GAITS",
    "HOLD_S",
    "REST_S",
    "STILL",
    "Body",
    "Engine",
    "Gait",
    "Odometry",
    "Pose",
    "Posture",
    "Range",
    "Robot",
    "Stance",
    "Velocity",
    "WalkState",
    "Walker",
]
