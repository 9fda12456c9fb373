"""The bridge as ROS 2 manages its nodes: its lifecycle, its parameters, and what it says of simulated time."""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.people.ros2.messages import DiagnosticArray, Imu, JointState, String, Twist
from schemas.words import Kind, Mode
from tests.support.bridged import GEOMETRY, WALKING, does, keeps, resting, strides
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, running
from tests.support.published import MEASURED, measures
from tests.support.rclpy_peer import COMMANDS, DIAGNOSTICS, DOMAIN, RclpyBridge, RclpyPeer, needs_rclpy

pytestmark = needs_rclpy
OWN_DOMAIN = DOMAIN % 100 + 1
JOINT_STATES = "/hexapod/joint_states"


@contextmanager
def managed(gateway: Gateway, *arguments: str) -> Iterator[RclpyPeer]:
    """Yield a bridge with these arguments, and a peer that receives its diagnostics."""
    with RclpyBridge(gateway, *arguments, domain=OWN_DOMAIN), RclpyPeer(OWN_DOMAIN) as peer:
        peer.subscribe(DIAGNOSTICS, DiagnosticArray)
        yield peer


@pytest.mark.skipif(os.geteuid() != 0, reason="to hide /etc/passwd needs root")
def test_a_user_without_a_home_and_a_passwd_entry_starts_it(gateway: Gateway) -> None:
    hidden = 'mount --bind /dev/null /etc/passwd && unset HOME && exec "$@"'
    with RclpyBridge(gateway, domain=OWN_DOMAIN, by=("unshare", "--mount", "sh", "-c", hidden, "sh")) as bridge:
        bridge.child.wait_for_output("ROS 2's graph")


def test_a_node_that_is_deactivated_sits_down_and_only_an_activation_and_drive_move_it_again(
    gateway: Gateway, watcher: Client
) -> None:
    happened, written = events(watcher), frames(watcher)
    with managed(gateway) as peer:
        assert peer.state() == "active"
        assert peer.call("/hexapod/drive")[0]
        peer.advertise("/hexapod/cmd_vel", Twist)
        keeps(lambda: peer.publish("/hexapod/cmd_vel", WALKING), lambda: strides(written), hz=20)
        assert peer.change_state("deactivate")
        assert watcher.state().mode == Mode.IDLE
        assert watcher.state().lease.holder is None
        assert Kind.WATCHDOG_EXPIRED not in {each.kind for each in happened.all}, "it sat down in order"
        assert peer.state() == "inactive"
        accepted, why = peer.call("/hexapod/drive")
        assert not accepted
        assert "the node is not active" in why
        peer.not_taken("/hexapod/cmd_vel", WALKING, "cmd_vel: the node is not active")
        assert peer.call("/hexapod/estop")[0], "in any state"
        assert watcher.reset().accepted
        assert peer.change_state("activate")
        peer.not_taken("/hexapod/cmd_vel", WALKING, "cmd_vel: nobody has called drive")
        assert not running(watcher), "by an activation alone nothing begins"
        assert peer.call("/hexapod/drive")[0]
        assert peer.change_state("shutdown")
        assert watcher.state().lease.holder is None
        assert peer.state() == "finalized"
        assert peer.call("/hexapod/estop")[0]


def test_parameters_by_file_and_by_name_are_rates_frames_and_where_other_joints_are(
    gateway: Gateway, watcher: Client, tmp_path: Path
) -> None:
    file = tmp_path / "hexapod.yaml"
    file.write_text(
        "/hexapod/hexapod_gateway:\n  ros__parameters:\n    base_frame: base_link\n    uncommanded_deg: 45.0\n"
    )
    arguments = ("--ros-args", "--params-file", str(file), "-p", "imu_frame:=imu_link", "-p", "joint_states_hz:=2.0")
    with managed(gateway, "--", *arguments) as peer, measures(watcher, MEASURED):
        assert (peer.parameter("base_frame"), peer.parameter("joint_states_hz")) == ("base_link", 2.0)
        assert math.isclose(peer.parameter("diagnostics_hz"), 1.0)
        done, why = peer.set_parameter("joint_states_hz", 10.0)
        assert not done
        assert "read-only" in why
        peer.subscribe("/hexapod/robot_description", String, latched=True)
        peer.subscribe("/hexapod/imu/data", Imu)
        peer.subscribe(JOINT_STATES, JointState)
        assert '<parent link="base_link" />' in peer.next("/hexapod/robot_description").data
        assert peer.next("/hexapod/imu/data").header.frame_id == "imu_link"
        first, second = (peer.next(JOINT_STATES) for _ in range(2))
        assert len(first.name) == 18
        known = {servo.id for leg in watcher.state().legs for servo in leg.servos if servo.angle_deg is not None}
        for name, at_rad in zip(first.name, first.position, strict=True):
            servo_id = int(name.removeprefix("joint_"))
            if servo_id not in known:
                assert at_rad == pytest.approx(GEOMETRY.joint_rad(servo_id, 45.0))
        begin, end = first.header.stamp, second.header.stamp
        assert end.sec - begin.sec + (end.nanosec - begin.nanosec) / 1e9 > 0.4


def test_in_simulated_time_nobody_may_drive(gateway: Gateway, watcher: Client) -> None:
    with managed(gateway, "--drive", "--", "--ros-args", "-p", "use_sim_time:=true") as peer:
        peer.advertise(COMMANDS, JointState)
        assert "the time of a robot is real" in does(peer.next(DIAGNOSTICS))
        accepted, why = peer.call("/hexapod/drive")
        assert not accepted
        assert "use_sim_time is set" in why
        peer.not_taken(COMMANDS, resting(), "joint_commands: use_sim_time is set")
        assert not running(watcher)
        assert watcher.state().lease.holder is None
        assert not peer.change_state("activate")
        assert peer.set_parameter("use_sim_time", False)[0]
        assert peer.change_state("activate")
        assert watcher.state().lease.holder == "ros2", "--drive"
        done, why = peer.set_parameter("use_sim_time", True)
        assert not done
        assert "the time of a robot is real" in why
