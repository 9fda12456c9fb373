"""Walking: body velocities in, servo angles out. Pure: time is an argument, and nothing here reads or sends.

A program, a console or a bridge drives a `Ride`. The ride decides which legs start, and stops when its driver falls
silent. `Engine` decides where the legs go, `Robot` where the feet can be.
"""

from gateway.people.walking.engine import Engine
from gateway.people.walking.gaits import GAITS, Gait
from gateway.people.walking.motion import DOWN, ORIGIN, STILL, BodyPose, Odometry, Posture, Velocity, WalkState
from gateway.people.walking.ride import HOLD_S, REST_S, USUAL_SILENCES, Phase, Ride, RideStep, RideTask, Silences, Wish
from gateway.people.walking.robot import Pose, Range, Robot, Stance
from gateway.people.walking.tempo import Distance
from gateway.people.walking.ways import LONGEST_S
from gateway.people.walking.words import ground_now, robot_now

__all__ = [
    "DOWN",
    "GAITS",
    "HOLD_S",
    "LONGEST_S",
    "ORIGIN",
    "REST_S",
    "STILL",
    "USUAL_SILENCES",
    "BodyPose",
    "Distance",
    "Engine",
    "Gait",
    "Odometry",
    "Phase",
    "Pose",
    "Posture",
    "Range",
    "Ride",
    "RideStep",
    "RideTask",
    "Robot",
    "Silences",
    "Stance",
    "Velocity",
    "WalkState",
    "Wish",
    "ground_now",
    "robot_now",
]
