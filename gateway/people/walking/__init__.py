"""Walking: body velocities in, servo angles out. Pure: time is an argument, and nothing here reads or sends.

`Walker` is what a program, a console or a bridge drives; it stops by itself when its driver falls silent. `Engine` is
the gait below it, `Robot` where the feet can be.
"""

from gateway.people.walking.engine import Engine, Odometry, Posture
from gateway.people.walking.gaits import GAITS, Gait
from gateway.people.walking.motion import STILL, Body, Velocity
from gateway.people.walking.robot import Pose, Range, Robot, Stance
from gateway.people.walking.walker import HOLD_S, REST_S, Walker, WalkState

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
