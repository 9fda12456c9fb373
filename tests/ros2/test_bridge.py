"""The bridge in a real ROS 2 graph (rclpy over FastDDS): what it shows, who may move the robot, its end."""

import math
import signal
import sys
import threading
from functools import partial

import pytest

from gateway.client import Client
from gateway.people.ros2.messages import WARN, DiagnosticArray, JointState, String
from gateway.people.ros2.robot import MEASURED
from schemas import keys
from schemas.words import Kind, Mode
from tests.support import published
from tests.support.bridged import LONG_S, WALKING, clean, commanded, does, keeps, resting
from tests.support.child import Child
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, running, states
from tests.support.rclpy_peer import (
    COMMANDS,
    DIAGNOSTICS,
    DOMAIN,
    ENV,
    PROFILE,
    PYTHON,
    RCLPY_COMMAND,
    RclpyBridge,
    RclpyPeer,
    needs_rclpy,
)
from tests.support.ros2_messages import Float64
from tests.support.waiting import meanwhile

pytestmark = needs_rclpy
OTHER_DOMAIN = DOMAIN % 100 + 1

# ---- in the graph

GRAPH = {
    "joint_states": "sensor_msgs/msg/JointState",
    "battery_state": "sensor_msgs/msg/BatteryState",
    "data": "sensor_msgs/msg/Imu",
    "foot_forces": "std_msgs/msg/Float64MultiArray",
    "odom": "nav_msgs/msg/Odometry",
    "temperature": "sensor_msgs/msg/Temperature",
    "robot_description": "std_msgs/msg/String",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "joint_commands": "sensor_msgs/msg/JointState",
    "cmd_vel": "geometry_msgs/msg/Twist",
    "cmd_vel_stamped": "geometry_msgs/msg/TwistStamped",
    "cmd_base_height": "std_msgs/msg/Float64",
    "roll_setpoint": "std_msgs/msg/Float64",
    "pitch_setpoint": "std_msgs/msg/Float64",
    "cmd_gait_type": "std_msgs/msg/Int32",
    "estop": "std_srvs/srv/Trigger",
    "reset": "std_srvs/srv/Trigger",
    "drive": "std_srvs/srv/Trigger",
    "release": "std_srvs/srv/Trigger",
    "transition_event": "lifecycle_msgs/msg/TransitionEvent",
    "change_state": "lifecycle_msgs/srv/ChangeState",
    "get_state": "lifecycle_msgs/srv/GetState",
    "get_available_states": "lifecycle_msgs/srv/GetAvailableStates",
    "get_available_transitions": "lifecycle_msgs/srv/GetAvailableTransitions",
    "get_transition_graph": "lifecycle_msgs/srv/GetAvailableTransitions",
}
"""Topics and services, and their types."""


def test_ros_itself_sees_its_topics_and_services(bridge: RclpyBridge, peer: RclpyPeer) -> None:
    bridge.child.wait_for_output("graph of rmw_fastrtps_cpp")
    found: dict[str, str] = {}

    def all_there() -> bool:
        graph = peer.graph()
        names = [each for each in graph if each.startswith("/hexapod/") and "parameter" not in each]
        found.clear()
        found.update({name.rpartition("/")[2]: graph[name][0] for name in names if "type_description" not in name})
        return len(found) >= len(GRAPH)

    keeps(lambda: None, all_there)
    assert found == GRAPH
    peer.subscribe("/hexapod/robot_description", String, latched=True)
    assert '<robot name="elkapod"' in peer.next("/hexapod/robot_description").data


def test_ros_itself_reads_what_the_robot_measures_and_rubbish_ends_nothing(peer: RclpyPeer, watcher: Client) -> None:
    """Published here in the gateway's place: without access control anybody may."""
    for topic, kind in MEASURED.items():
        peer.subscribe(f"/hexapod/{topic}", kind)
    watcher.publish(keys.TELEMETRY, {"battery": "full"})
    with published.measures(watcher, published.MEASURED):
        battery, imu, temperature, feet = (peer.next(f"/hexapod/{topic}") for topic in MEASURED)
    assert battery.percentage == pytest.approx(0.8)
    assert math.isnan(battery.current)
    assert (imu.header.frame_id, imu.linear_acceleration.z) == ("base", 9.81)
    assert temperature.temperature == 31.5
    assert feet.data == published.MEASURED.feet


# ---- nothing moves unasked


def test_nothing_is_taken_before_somebody_drives(peer: RclpyPeer, watcher: Client) -> None:
    before = watcher.state().commands
    for topic, message in ((COMMANDS, resting()), ("/hexapod/cmd_vel", WALKING)):
        peer.not_taken(topic, message, f"{topic.rpartition('/')[2]}: nobody has called drive")
    assert not running(watcher)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder is None


def test_the_bridge_drives_visibly_until_it_is_released(peer: RclpyPeer, watcher: Client) -> None:
    assert peer.call("/hexapod/drive") == (True, "drives as ros2")
    assert watcher.state().lease.holder == "ros2"
    assert peer.call("/hexapod/drive") == (True, "it drives already")
    assert peer.call("/hexapod/release") == (True, "released")
    assert watcher.state().lease.holder is None
    with watcher.lease():
        accepted, why = peer.call("/hexapod/drive")
        assert not accepted
        assert "held by watcher" in why


# ---- the emergency stop


def test_any_peer_stops_it_always(peer: RclpyPeer, watcher: Client) -> None:
    done, what = peer.call("/hexapod/estop")
    assert done
    assert "6 Stop frames written" in what
    first = watcher.state().estop
    with RclpyPeer() as other:
        other.publish_empty("/hexapod/estop")
        states(watcher).wait(lambda state: state.estop == first + 1)
    assert peer.call("/hexapod/drive") == (False, "rejected: estopped: the emergency stop is engaged; reset leaves it")
    assert watcher.reset().accepted


def test_a_flood_keeps_no_emergency_stop_waiting(driven: RclpyPeer, watcher: Client) -> None:
    with RclpyPeer() as flooding:
        flooding.advertise(COMMANDS, JointState)
        with meanwhile(lambda: flooding.publish(COMMANDS, resting())):
            keeps(lambda: None, lambda: len(running(watcher)) == 6)
            first = watcher.state().estop
            for number in (1, 2):
                assert driven.call("/hexapod/estop")[0]
                assert watcher.state().estop == first + number
    states(watcher).wait(lambda state: state.lease.holder is None)


def test_after_an_emergency_stop_and_a_reset_nothing_goes_on_by_itself(driven: RclpyPeer, watcher: Client) -> None:
    keeps(lambda: driven.publish(COMMANDS, resting()), lambda: len(running(watcher)) == 6)
    seen = states(watcher)
    watcher.estop()
    keeps(lambda: driven.publish(COMMANDS, resting()), lambda: any(state.lease.holder is None for state in seen.all))
    assert watcher.reset().accepted
    driven.not_taken(COMMANDS, resting(), "after that nobody has called drive")
    assert not running(watcher)
    assert watcher.state().mode == Mode.IDLE


def test_an_emergency_stop_while_nothing_moves_ends_the_driving_too(driven: RclpyPeer, watcher: Client) -> None:
    seen = states(watcher)
    watcher.estop()
    seen.wait(lambda state: state.lease.holder is None)
    assert watcher.reset().accepted
    driven.next(DIAGNOSTICS, lambda each: "an emergency stop was engaged, or the gateway started again" in does(each))
    assert not running(watcher)


@pytest.mark.parametrize("sits", ["release", "deactivate"])
def test_an_emergency_stop_waits_for_no_other_service(sits: str, driven: RclpyPeer, watcher: Client) -> None:
    """Both sit down for some seconds before they answer."""
    happened = events(watcher)
    keeps(lambda: driven.publish("/hexapod/cmd_vel", WALKING), lambda: len(running(watcher)) == 6, hz=20)
    driven.next(DIAGNOSTICS, lambda each: does(each) == "drives by cmd_vel")
    with RclpyPeer() as other:
        release = partial(other.call, "/hexapod/release")
        releasing = threading.Thread(target=release if sits == "release" else partial(other.change_state, sits))
        releasing.start()
        driven.next(DIAGNOSTICS, lambda each: does(each) == "drives; nothing moves")
        assert driven.call("/hexapod/estop")[0]
        releasing.join()
    both = [each.kind for each in happened.all if each.kind in (Kind.ESTOP_ENGAGED, Kind.LEASE_RELEASED)]
    assert both == [Kind.ESTOP_ENGAGED, Kind.LEASE_RELEASED]
    if sits == "deactivate":
        assert driven.state() == "inactive"
        assert driven.change_state("activate")


# ---- beginning and end


def test_the_bridge_ends_at_a_signal_and_stops_what_runs(gateway: Gateway, watcher: Client) -> None:
    with RclpyBridge(gateway, "--drive", domain=OTHER_DOMAIN) as own, RclpyPeer(OTHER_DOMAIN) as peer:
        assert watcher.state().lease.holder == "ros2", str(own.child)
        peer.advertise(COMMANDS, JointState)
        keeps(lambda: peer.publish(COMMANDS, resting()), lambda: len(running(watcher)) == 6)
        own.child.send_signal(signal.SIGINT)
        assert own.child.wait() == 0
        assert watcher.state().mode == Mode.IDLE
        assert watcher.state().lease.holder is None


def test_a_bridge_that_dies_leaves_the_legs_to_the_watchdog(gateway: Gateway, watcher: Client) -> None:
    happened = events(watcher)
    with RclpyBridge(gateway, "--drive", domain=OTHER_DOMAIN) as own, RclpyPeer(OTHER_DOMAIN) as peer:
        peer.advertise("/hexapod/cmd_base_height", Float64)
        peer.publish("/hexapod/cmd_base_height", Float64(0.12))
        keeps(lambda: None, lambda: len(running(watcher)) == 6)
        own.child.kill()
        happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
    with watcher.lease(take=True):  # not waiting until it has expired
        pass


def test_a_graph_that_others_may_reach_is_shown_in_diagnostics_state_and_events(
    gateway: Gateway, watcher: Client
) -> None:
    """Also with ROS's own range LOCALHOST, which leaves the sockets open."""
    happened = events(watcher)
    command = ("ros2", "--drive", "--connect", gateway.endpoint, "--domain", str(OTHER_DOMAIN))
    own = Child([*RCLPY_COMMAND, *command], clean() | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    own.wait_for_output("is in ROS 2's graph")
    assert "ROS 2's graph is open to the network (rmw_fastrtps_cpp has sockets on 0.0.0.0" in own.stderr
    assert watcher.state().lease.holder == "ros2 (open graph)"
    with RclpyPeer(OTHER_DOMAIN) as peer:
        peer.subscribe(DIAGNOSTICS, DiagnosticArray)
        bridges = peer.next(DIAGNOSTICS).status[-1]
        assert bridges.level == WARN
        assert "all who reach it can drive the robot" in bridges.message
    own.terminate()
    assert own.wait() == 0
    own.close()
    happened.wait(lambda event: event.kind == Kind.LEASE_RELEASED and event.source == "ros2 (open graph)")


def test_the_example_walks_by_the_elkapods_own_topic_and_joint_names(gateway: Gateway, watcher: Client) -> None:
    remap = ("--ros-args", "-r", "cmd_vel:=/cmd_vel_out")
    written = frames(watcher)
    arguments = ("--joint-names", "leg{leg}_J{joint}", "--", *remap)
    with RclpyBridge(gateway, *arguments, domain=OTHER_DOMAIN), RclpyPeer(OTHER_DOMAIN) as peer:
        peer.subscribe("/hexapod/robot_description", String, latched=True)
        assert 'name="leg6_J3"' in peer.next("/hexapod/robot_description").data
        example = Child(
            [PYTHON, str(PROFILE.parent / "walk.py"), *remap, "-r", "__ns:=/hexapod"],
            clean() | ENV | {"ROS_DOMAIN_ID": str(OTHER_DOMAIN)},
        )
        assert example.wait(LONG_S) == 0, example
        example.close()
        peer.subscribe("/hexapod/joint_states", JointState)
        names = peer.next("/hexapod/joint_states", lambda each: len(each.name) == 18).name
    assert example.stdout == "drive: drives as ros2\nrelease: released\n"
    assert (names[0], names[-1]) == ("leg1_J1", "leg6_J3")
    assert len(set(commanded(written.all, 11))) > 20
    assert watcher.state().mode == Mode.IDLE


def test_without_ros_it_names_what_to_install() -> None:
    program = "import sys; sys.modules['rclpy'] = None; from gateway.cli import main; sys.argv[1:] = ['ros2']; main()"
    child = Child([sys.executable, "-c", program], clean())
    assert child.wait() == 2
    child.close()
    assert "pip install 'hexapod-gateway[rclpy]'" in child.stderr
