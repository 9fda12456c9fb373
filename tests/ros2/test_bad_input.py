"""What no ROS peer would send to the bridge moves nothing. Of each kind one; tests/unit/people/test_ros2_* have all."""

from typing import Any, Final

import pytest

from gateway.client import Client
from gateway.people.ros2.cdr import encode
from gateway.people.ros2.messages import JointState, String
from tests.support.bridged import Bridge, rejected, resting

# ---- bad input

BAD: Final[dict[str, tuple[bytes, dict[str, Any], str]]] = {
    "no attachment": (encode(resting()), {"attachment": b""}, "it has no attachment"),
    "another hash": (
        encode(resting()),
        {"key": "0/hexapod/joint_commands/sensor_msgs::msg::dds_::JointState_/RIHS01_0000"},
        "its sensor_msgs/msg/JointState has the hash RIHS01_0000",
    ),
    "another type": (
        encode(String("hm")),
        {"key": "0/hexapod/joint_commands/std_msgs::msg::dds_::String_/RIHS01_0000"},
        "it is a std_msgs::msg::dds_::String_, and this topic has sensor_msgs/msg/JointState",
    ),
    "truncated": (encode(resting())[:-9], {}, "position: ends"),
    "a megabyte": (encode(resting()) + bytes(1_000_000), {}, "and at most 4096 are taken"),
    "not a number": (encode(resting(joint_32=float("nan"))), {}, "the position of joint_32 is nan"),
    "beyond its servo": (encode(resting(joint_32=7.0)), {}, "joint_32 at"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_moves_nothing_and_says_why(name: str, driven: Bridge, watcher: Client) -> None:
    payload, options, why = BAD[name]
    before = watcher.state().commands
    with rejected(driven, why):
        driven.publisher("joint_commands", JointState).put(payload, **options)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder == "ros2", "it drives on"
