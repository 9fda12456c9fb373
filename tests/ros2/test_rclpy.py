"""The bridge as a node of rclpy, with a real ROS 2 peer over FastDDS. How it moves: test_motion, by the other way."""

import itertools
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.people.ros2.cdr import Message
from gateway.people.ros2.messages import (
    DiagnosticArray,
    ImuMessage,
    JointState,
    JointTrajectory,
    String,
    Twist,
    Vector3,
)
from gateway.people.ros2.robot import MEASURED
from schemas.telemetry import Kind, Mode
from tests.ros2.test_motion import LAST_DEG, plan, rests, strides, written_by_rosbags
from tests.support import measuring
from tests.support.bad_ros2 import BAD
from tests.support.bridged import GEOMETRY, LONG_S, RESTS_DEG, clean, commanded, keeps, resting
from tests.support.child import Child
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, running, states
from tests.support.rclpy_peer import DOMAIN, ENV, PROFILE, PYTHON, RCLPY_COMMAND, RclpyBridge, RclpyPeer, needs_rclpy

pytestmark = needs_rclpy
COMMANDS = "/hexapod/joint_commands"
DIAGNOSTICS = "/hexapod/diagnostics"
WALKING = Twist(Vector3(0.05))


@pytest.fixture(scope="module")
def rclpy_bridge(gateway: Gateway) -> Iterator[RclpyBridge]:
    """RMW_IMPLEMENTATION names FastDDS, so this way is the default."""
    with RclpyBridge(gateway) as running_one:
        assert "graph of rmw_fastrtps_cpp" in running_one.child.stdout
        running_one.child.wait_for_output("no action follow_joint_trajectory: this ROS 2 has no control_msgs")
        yield running_one


@pytest.fixture(scope="module")
def one_peer(rclpy_bridge: RclpyBridge) -> Iterator[RclpyPeer]:
    del rclpy_bridge
    with RclpyPeer() as running_one:
        running_one.subscribe(DIAGNOSTICS, DiagnosticArray)
        running_one.advertise(COMMANDS, JointState)
        yield running_one


@pytest.fixture
def peer(one_peer: RclpyPeer, watcher: Client) -> Iterator[RclpyPeer]:
    """Beside a bridge that does not drive, whatever the test before has left."""
    yield one_peer
    watcher.reset()
    one_peer.call("/hexapod/release")


@pytest.fixture
def driven(peer: RclpyPeer) -> RclpyPeer:
    assert peer.call("/hexapod/drive") == (True, "drives as ros2")
    return peer


def rejections(array: DiagnosticArray) -> str:
    return next((each.value for each in array.status[-1].values if each.key == "latest_rejection"), "")


def test_ros_itself_sees_its_topics_and_services(peer: RclpyPeer) -> None:
    graph = peer.graph()
    found = {name: types for name, types in graph.items() if name.startswith("/hexapod/") and "parameter" not in name}
    assert {name.rpartition("/")[2]: kind for name, [kind] in found.items() if "type_description" not in name} == {
        "joint_states": "sensor_msgs/msg/JointState",
        "battery_state": "sensor_msgs/msg/BatteryState",
        "data": "sensor_msgs/msg/Imu",
        "foot_forces": "std_msgs/msg/Float64MultiArray",
        "temperature": "sensor_msgs/msg/Temperature",
        "robot_description": "std_msgs/msg/String",
        "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        "joint_commands": "sensor_msgs/msg/JointState",
        "joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
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
    peer.subscribe("/hexapod/robot_description", String, latched=True)
    assert '<robot name="elkapod"' in peer.next_where("/hexapod/robot_description", lambda _: True).data


def test_ros_itself_reads_what_the_robot_measures(peer: RclpyPeer, watcher: Client) -> None:
    """Published here in the gateway's place."""
    for topic, kind in MEASURED.items():
        peer.subscribe(f"/hexapod/{topic}", kind)
    with measuring.measures(watcher, measuring.MEASURED):
        battery, imu, temperature, feet = (peer.next_where(f"/hexapod/{topic}", lambda _: True) for topic in MEASURED)
    assert battery.percentage == pytest.approx(0.8)
    assert (imu.header.frame_id, imu.linear_acceleration.z) == ("base", 9.81)
    assert temperature.temperature == 31.5
    assert feet.data == measuring.MEASURED.feet


def test_nothing_is_taken_before_somebody_drives(peer: RclpyPeer, watcher: Client) -> None:
    peer.publish(COMMANDS, resting())
    peer.next_where(DIAGNOSTICS, lambda each: "joint_commands: nobody has called drive" in rejections(each))
    assert not running(watcher)
    assert watcher.state().lease.holder is None


@pytest.mark.parametrize("serialized", [False, True], ids=["as messages", "as serialised bytes"])
def test_joint_commands_become_frames_and_their_silence_stops_the_legs(
    serialized: bool, driven: RclpyPeer, watcher: Client
) -> None:
    happened, written, steps = events(watcher), frames(watcher), itertools.count()
    driven.subscribe("/hexapod/joint_states", JointState)
    publish = driven.publish_serialized if serialized else driven.publish
    keeps(
        lambda: publish(COMMANDS, resting(joint_11=next(steps) / 1000)),
        lambda: len(running(watcher)) == 6,
    )
    sent = next(steps)
    happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
    angles = commanded(written.all, 11)
    assert len(set(angles)) == len(angles) > 5, "each angle was sent once, so it is written once at most"
    assert len(angles) <= sent
    states(watcher).wait(lambda state: state.lease.holder is None)
    last = GEOMETRY.joint_rad(11, angles[-1])
    driven.next_where("/hexapod/joint_states", lambda each: bool(each.position) and abs(each.position[0] - last) < 1e-3)


def test_bad_messages_move_nothing_and_each_is_explained(driven: RclpyPeer, watcher: Client) -> None:
    """As over Zenoh, test_bad_input. What is no such message does not come over DDS."""
    before = watcher.state().commands
    for topic in dict.fromkeys(topic for topic, _, _ in BAD.values()):
        driven.advertise(f"/hexapod/{topic}", next(type(message) for name, message, _ in BAD.values() if name == topic))
    for topic, message, why in BAD.values():

        def explained(array: DiagnosticArray, topic: str = topic, message: Message = message, why: str = why) -> bool:
            driven.publish(f"/hexapod/{topic}", message)
            return why in rejections(array)

        driven.next_where(DIAGNOSTICS, explained)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder == "ros2", "it drives on"


def test_a_bag_that_rosbags_has_written_is_played(driven: RclpyPeer, watcher: Client, tmp_path: Path) -> None:
    """Its bytes are published as they are, as `ros2 bag play` does."""
    recorded = written_by_rosbags(tmp_path / "bag")
    written, played = frames(watcher), iter(recorded)
    keeps(
        lambda: driven.publish_bytes(COMMANDS, next(played, recorded[-1])),
        lambda: commanded(written.all, 11)[-1:] == [LAST_DEG],
    )
    assert len(set(commanded(written.all, 11))) > 5


@pytest.mark.parametrize("best_effort", [False, True], ids=["the default", "SensorData"])
def test_peers_of_any_quality_of_service_are_served(best_effort: bool, driven: RclpyPeer, watcher: Client) -> None:
    topic = "/hexapod/imu/data"
    del driven
    with RclpyPeer() as other, measuring.measures(watcher, measuring.MEASURED):
        other.subscribe(topic, ImuMessage, best_effort=best_effort)
        assert other.next_where(topic, lambda _: True).linear_acceleration.z == 9.81
        other.advertise(COMMANDS, JointState, best_effort=best_effort)
        keeps(lambda: other.publish(COMMANDS, resting()), lambda: len(running(watcher)) == 6)


# ---- the emergency stop


def test_a_flood_keeps_no_emergency_stop_waiting_and_ros_leaves_its_own_alone(
    driven: RclpyPeer, watcher: Client
) -> None:
    with RclpyPeer() as flooding:
        flooding.advertise(COMMANDS, JointState)
        ended = threading.Event()

        def flood() -> None:
            while not ended.is_set():
                flooding.publish(COMMANDS, resting())

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            keeps(lambda: None, lambda: len(running(watcher)) == 6)
            first = watcher.state().estop
            for number in (1, 2):
                assert driven.call("/hexapod/estop")[0]
                assert watcher.state().estop == first + number
        finally:
            ended.set()
            thread.join()
    states(watcher).wait(lambda state: state.lease.holder is None)
    assert driven.call("/hexapod/reset")[0]
    assert watcher.state().mode == Mode.IDLE
    watcher.estop()
    left, why = driven.call("/hexapod/reset")
    assert not left
    assert "leave it at the robot" in why


@pytest.mark.parametrize("sits", ["release", "deactivate"])
def test_an_emergency_stop_waits_for_no_other_service(sits: str, driven: RclpyPeer, watcher: Client) -> None:
    """Both sit down for some seconds before they answer."""
    happened = events(watcher)
    driven.advertise("/hexapod/cmd_vel", Twist)
    keeps(lambda: driven.publish("/hexapod/cmd_vel", WALKING), lambda: len(running(watcher)) == 6, hz=20)
    driven.next_where(DIAGNOSTICS, lambda each: each.status[-1].message == "drives by cmd_vel")
    with RclpyPeer() as other:
        release = partial(other.call, "/hexapod/release")
        releasing = threading.Thread(target=release if sits == "release" else partial(other.change_state, sits))
        releasing.start()
        driven.next_where(DIAGNOSTICS, lambda each: each.status[-1].message == "drives; nothing moves")
        assert driven.call("/hexapod/estop")[0]
        releasing.join()
    both = [each.kind for each in happened.all if each.kind in (Kind.ESTOP_ENGAGED, Kind.LEASE_RELEASED)]
    assert both == [Kind.ESTOP_ENGAGED, Kind.LEASE_RELEASED]
    if sits == "deactivate":
        assert driven.state() == "inactive"
        assert driven.change_state("activate")


# ---- several nodes


def test_of_two_nodes_that_fight_the_first_is_followed_until_it_is_silent(driven: RclpyPeer, watcher: Client) -> None:
    written, happened = frames(watcher), events(watcher)
    with RclpyPeer() as second:
        second.advertise(COMMANDS, JointState)
        keeps(lambda: driven.publish(COMMANDS, resting()), lambda: len(running(watcher)) == 6)
        rejected = "joint_commands: another node publishes here, and is followed until it is silent for 0.5 s"

        def both() -> None:
            driven.publish(COMMANDS, resting())
            second.publish(COMMANDS, resting(joint_11=0.2))

        steps = itertools.count()
        keeps(both, lambda: next(steps) > 50)
        assert set(commanded(written.all, 11)) == {RESTS_DEG[1]}
        driven.next_where(DIAGNOSTICS, lambda each: rejections(each) == rejected)
        happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
        states(watcher).wait(lambda state: state.lease.holder is None)
        assert driven.call("/hexapod/drive")[0]
        keeps(
            lambda: second.publish(COMMANDS, resting(joint_11=0.2)),
            lambda: commanded(written.all, 11)[-1] > RESTS_DEG[1] + 10,
        )


def test_nodes_that_come_and_go_ten_times_a_second_disturb_no_walk(driven: RclpyPeer, watcher: Client) -> None:
    happened = events(watcher)
    driven.advertise("/hexapod/cmd_vel", Twist)
    written = frames(watcher)
    with RclpyPeer() as churning:
        thread = threading.Thread(target=churning.churn, args=("/hexapod/cmd_vel", 50))
        keeps(lambda: driven.publish("/hexapod/cmd_vel", WALKING), lambda: strides(written), hz=20)
        thread.start()
        keeps(lambda: driven.publish("/hexapod/cmd_vel", WALKING), lambda: not thread.is_alive(), hz=20)
        thread.join()
    assert strides(written), "it walks"
    assert len(running(watcher)) == 6
    assert not [each for each in happened.all if each.kind in (Kind.WATCHDOG_EXPIRED, Kind.LEASE_RELEASED)]


def test_a_peer_that_is_killed_in_mid_walk_leaves_a_robot_that_stands_and_then_sits(
    driven: RclpyPeer, watcher: Client
) -> None:
    del driven
    written = frames(watcher)
    with RclpyPeer() as walking:
        walking.advertise("/hexapod/cmd_vel", Twist)
        keeps(lambda: walking.publish("/hexapod/cmd_vel", WALKING), lambda: strides(written), hz=20)
        walking.child.kill()
        keeps(lambda: None, lambda: rests(written, 11, 12, 22, count=50))
        assert len(running(watcher)) == 6, "it stands"
        states(watcher).wait(lambda state: state.mode == Mode.IDLE, timeout_s=LONG_S)
    assert watcher.state().lease.holder == "ros2", "another may go on"


# ---- trajectories


@pytest.mark.parametrize("dies", [False, True], ids=["it withdraws", "it is killed"])
def test_a_peer_that_vanishes_in_mid_trajectory_has_the_robot_sit_down(
    dies: bool, driven: RclpyPeer, watcher: Client
) -> None:
    """The profile has DDS notice a killed process after 3 s."""
    del driven
    written = frames(watcher)
    with RclpyPeer() as vanishing:
        vanishing.advertise("/hexapod/joint_trajectory", JointTrajectory)
        vanishing.publish("/hexapod/joint_trajectory", plan((0.5, 0.0), (55.0, 1.0)))
        keeps(lambda: None, lambda: len(set(commanded(written.all, 11))) > 5)
        if dies:
            vanishing.child.kill()
        else:
            vanishing.withdraw("/hexapod/joint_trajectory")
        states(watcher).wait(lambda state: state.mode == Mode.IDLE, timeout_s=LONG_S)
    assert max(commanded(written.all, 11)) < RESTS_DEG[1] + 57, "it did not follow it to its end"
    assert watcher.state().lease.holder == "ros2", "another may go on"


# ---- as another stack has it


def test_the_example_walks_by_the_elkapods_own_topic_and_joint_names(gateway: Gateway, watcher: Client) -> None:
    remap = ("--ros-args", "-r", "cmd_vel:=/cmd_vel_out")
    domain = DOMAIN % 100 + 1
    written = frames(watcher)
    arguments = ("--via", "rclpy", "--joint-names", "leg{leg}_J{joint}", "--", *remap)
    with RclpyBridge(gateway, *arguments, domain=domain), RclpyPeer(domain) as peer:
        peer.subscribe("/hexapod/robot_description", String, latched=True)
        assert 'name="leg6_J3"' in peer.next_where("/hexapod/robot_description", lambda _: True).data
        example = Child(
            [PYTHON, str(PROFILE.parent / "walk.py"), *remap, "-r", "__ns:=/hexapod"],
            clean() | ENV | {"ROS_DOMAIN_ID": str(domain)},
        )
        assert example.wait(LONG_S) == 0, example
        example.close()
        peer.subscribe("/hexapod/joint_states", JointState)
        names = peer.next_where("/hexapod/joint_states", lambda each: len(each.name) == 18).name
    assert example.stdout == "drive: drives as ros2\nrelease: released\n"
    assert (names[0], names[-1]) == ("leg1_J1", "leg6_J3")
    assert len(set(commanded(written.all, 11))) > 20
    assert watcher.state().mode == Mode.IDLE


# ---- who reaches the graph


def test_a_graph_that_others_reach_is_rejected_unless_that_is_accepted(gateway: Gateway, watcher: Client) -> None:
    """Also with ROS's own range LOCALHOST, which leaves the sockets open."""
    command = ("ros2", "--via", "rclpy", "--connect", gateway.endpoint, "--domain", str(DOMAIN % 100 + 1))
    env = clean() | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    tried = Child([*RCLPY_COMMAND, *command], env)
    assert tried.wait() == 2, tried
    tried.close()
    assert "ROS 2's graph is open to the network (rmw_fastrtps_cpp has sockets on 0.0.0.0" in tried.stderr
    accepted = Child([*RCLPY_COMMAND, *command, "--open-graph", "--drive"], env)
    accepted.wait_for_output("is in ROS 2's graph", timeout_s=20)
    assert watcher.state().lease.holder == "ros2 (open graph)"
    accepted.terminate()
    assert accepted.wait() == 0
    accepted.close()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("--via", "rclpy", "--router", "tcp/127.0.0.1:1"), "--router and --router-config are for --via zenoh"),
        (("--via", "rclpy", "--", "--ros-args", "-r", "nonsense"), "ROS 2 does not start"),
        (("--via", "rclpy", "--tf"), "this ROS 2 has no tf2_msgs"),
        (("--via", "zenoh", "--", "--ros-args"), "ROS 2's own arguments are for --via rclpy"),
        (("--joint-names", "J{joint}"), "gives two joints one name"),
    ],
)
def test_what_it_cannot_begin_with(arguments: tuple[str, ...], why: str, gateway: Gateway) -> None:
    tried = Child([*RCLPY_COMMAND, "ros2", "--connect", gateway.endpoint, *arguments], clean() | ENV)
    assert tried.wait() == 2, tried
    tried.close()
    assert why in tried.stderr
