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


TRAJECTORY: Final = JointTrajectory(
    Header(), MANY, (JointTrajectoryPoint((0.0,) * len(MANY), time_from_start=Duration(1)),)
)
BAD: Final[dict[str, tuple[str, Message, str]]] = {
    "10 000 joints": ("joint_commands", JointState(name=MANY, position=(0.0,) * 10_000), "and at most 4096 are taken"),
    "simulated time": ("joint_commands", replace(resting(), header=SIMULATED), "it has a stamp of 1970-01-01"),
    "a trajectory of 10 000 joints": ("joint_trajectory", TRAJECTORY, "there is no joint"),
    "a velocity of NaN": ("cmd_vel", Twist(Vector3(math.nan)), "cmd_vel: "),
    "a velocity in simulated time": (
        "cmd_vel_stamped",
        TwistStamped(SIMULATED, Twist(Vector3(0.05))),
        "it has a stamp of 1970-01-01",
    ),
    "a height of NaN": ("cmd_base_height", Float64(math.nan), "a height and a leaning are finite numbers"),
    "a gait that is none": ("cmd_gait_type", Int32(77), "there is no gait 77"),
}
"""Topic, message and what the diagnostics say, of each topic one or two; all: tests/unit/people/test_ros2_joints.py."""
