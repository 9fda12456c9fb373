"""What ROS peers must not send, as messages: none of them moves anything, and each has its sentence in diagnostics."""

import math
from typing import Final

from gateway.people.ros2.messages import Header, JointState, Message, Time, Twist, Vector3
from tests.support.bridged import resting
from tests.support.ros2_messages import (
    Duration,
    Float64,
    Int32,
    JointTrajectory,
    JointTrajectoryPoint,
    TwistStamped,
    replace,
)

SIMULATED: Final = Header(Time(12, 500_000_000))
"""As a simulator's clock has it, some seconds after its start."""
MANY: Final = tuple(f"joint_{number}" for number in range(10_000))


def _trajectory(names: tuple[str, ...], at_rad: tuple[float, ...], header: Message | None = None) -> Message:
    return JointTrajectory(header or Header(), names, (JointTrajectoryPoint(at_rad, time_from_start=Duration(1)),))


NAMES, AT_RAD = resting().name, resting().position
BAD: Final[dict[str, tuple[str, Message, str]]] = {
    "NaN": ("joint_commands", resting(joint_32=math.nan), "the position of joint_32 is nan"),
    "infinity": ("joint_commands", resting(joint_32=-math.inf), "the position of joint_32 is -inf"),
    "beyond its servo": ("joint_commands", resting(joint_32=7.0), "joint_32 at"),
    "another robot's names": (
        "joint_commands",
        JointState(name=("leg1_J1", "leg1_J2", "leg1_J3"), position=(0.0,) * 3),
        "there is no joint 'leg1_J1'",
    ),
    "10 000 joints": ("joint_commands", JointState(name=MANY, position=(0.0,) * 10_000), "and at most 4096 are taken"),
    "simulated time": ("joint_commands", replace(resting(), header=SIMULATED), "it has a stamp of 1970-01-01"),
    "a trajectory of 10 000 joints": ("joint_trajectory", _trajectory(MANY, (0.0,) * 10_000), "there is no joint"),
    "a trajectory with NaN": ("joint_trajectory", _trajectory(NAMES, (*AT_RAD[:17], math.nan)), "joint_63 is nan"),
    "a trajectory in simulated time": (
        "joint_trajectory",
        _trajectory(NAMES, AT_RAD, SIMULATED),
        "it has a stamp of 1970-01-01",
    ),
    "a velocity of NaN": ("cmd_vel", Twist(Vector3(math.nan)), "cmd_vel: "),
    "an infinite velocity": ("cmd_vel", Twist(angular=Vector3(z=math.inf)), "cmd_vel: "),
    "a velocity in simulated time": (
        "cmd_vel_stamped",
        TwistStamped(SIMULATED, Twist(Vector3(0.05))),
        "it has a stamp of 1970-01-01",
    ),
    "a height of NaN": ("cmd_base_height", Float64(math.nan), "a height and a leaning are finite numbers"),
    "a gait that is none": ("cmd_gait_type", Int32(77), "there is no gait 77"),
}
"""Topic, message and what the diagnostics say."""
