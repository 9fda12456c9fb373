"""What no ROS peer should send to the bridge moves nothing. Of each kind one; tests/unit/people/test_ros2_* have all.

By rclpy: test_rclpy.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import pytest

from gateway.client import Client
from gateway.people.ros2.cdr import encode
from gateway.people.ros2.messages import DiagnosticArray, JointState, String
from tests.support.bad_ros2 import BAD
from tests.support.bridged import Bridge, Received, rejected, resting

NOT_ROS: Final[dict[str, tuple[bytes, dict[str, Any], str]]] = {
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
}
"""Bytes, how they are put, and what the diagnostics say."""


@pytest.mark.parametrize("name", NOT_ROS)
def test_what_is_no_message_moves_nothing_and_is_explained(name: str, driven: Bridge, watcher: Client) -> None:
    payload, options, why = NOT_ROS[name]
    before = watcher.state().commands
    with rejected(driven, why):
        driven.publisher("joint_commands", JointState).put(payload, **options)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder == "ros2", "it drives on"


def test_bad_messages_move_nothing_and_each_is_explained(driven: Bridge, watcher: Client) -> None:
    """Again and again: what comes just after a pause of the machine has another reason."""
    before, received = watcher.state().commands, Received(driven, "diagnostics", DiagnosticArray)
    for topic, message, why in BAD.values():
        publish = partial(driven.publisher(topic, type(message)).publish, message)

        def explained(array: DiagnosticArray, publish: Callable[[], None] = publish, why: str = why) -> bool:
            publish()
            return any(why in value.value for value in array.status[-1].values if value.key == "latest_rejection")

        received.wait(explained)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder == "ros2", "it drives on"


def test_a_clock_that_was_never_set_moves_nothing(driven: Bridge, watcher: Client) -> None:
    before = watcher.state().commands
    with rejected(driven, "joint_commands: it was sent at a time of 1970-01-01, by its sender's clock"):
        driven.publisher("joint_commands", JointState).publish(resting(), sent_ns=40_000_000_000)
    assert watcher.state().commands == before
