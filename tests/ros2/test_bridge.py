"""The bridge between a real gateway and a ROS router, with peers that we did not write (zenoh-ros2-sdk)."""

import math
import signal
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.people.ros2.cdr import decode, encode
from gateway.people.ros2.messages import (
    TRIGGER_HASH,
    TRIGGER_TYPE,
    DiagnosticArray,
    DiagnosticStatus,
    Float64,
    JointState,
    String,
    TriggerRequest,
    TriggerResponse,
    Twist,
    Vector3,
)
from gateway.people.ros2.robot import MEASURED
from gateway.people.ros2.wire import Attachment
from schemas import keys
from schemas.telemetry import GatewayState, Kind, Mode
from tests.support import measuring
from tests.support.bridged import PATIENT, Bridge, Received, bridged, clean, keeps, rejected, resting
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.gateway_process import COMMAND, Gateway, free_port
from tests.support.heard import events, running, states
from tests.support.ros2_peer import Peer
from tests.support.router import zenoh_listening

# ---- in the graph


def test_a_peer_sees_its_topics_and_services(peer: Peer) -> None:
    graph = peer.graph()
    assert {name: types for name, types in graph.items() if name.startswith("/hexapod/") or name == "/tf"} == {
        "/tf": ["tf2_msgs/msg/TFMessage"],
        "/hexapod/joint_states": ["sensor_msgs/msg/JointState"],
        "/hexapod/battery_state": ["sensor_msgs/msg/BatteryState"],
        "/hexapod/imu/data": ["sensor_msgs/msg/Imu"],
        "/hexapod/temperature": ["sensor_msgs/msg/Temperature"],
        "/hexapod/foot_forces": ["std_msgs/msg/Float64MultiArray"],
        "/hexapod/robot_description": ["std_msgs/msg/String"],
        "/hexapod/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"],
        "/hexapod/joint_commands": ["sensor_msgs/msg/JointState"],
        "/hexapod/joint_trajectory": ["trajectory_msgs/msg/JointTrajectory"],
        "/hexapod/cmd_vel": ["geometry_msgs/msg/Twist"],
        "/hexapod/cmd_vel_stamped": ["geometry_msgs/msg/TwistStamped"],
        "/hexapod/cmd_base_height": ["std_msgs/msg/Float64"],
        "/hexapod/roll_setpoint": ["std_msgs/msg/Float64"],
        "/hexapod/pitch_setpoint": ["std_msgs/msg/Float64"],
        "/hexapod/cmd_gait_type": ["std_msgs/msg/Int32"],
        "/hexapod/follow_joint_trajectory/_action/feedback": [
            "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
        ],
        "/hexapod/follow_joint_trajectory/_action/status": ["action_msgs/msg/GoalStatusArray"],
        "/hexapod/follow_joint_trajectory/_action/send_goal": ["control_msgs/action/FollowJointTrajectory_SendGoal"],
        "/hexapod/follow_joint_trajectory/_action/get_result": ["control_msgs/action/FollowJointTrajectory_GetResult"],
        "/hexapod/follow_joint_trajectory/_action/cancel_goal": ["action_msgs/srv/CancelGoal"],
        "/hexapod/estop": ["std_srvs/srv/Trigger"],
        "/hexapod/reset": ["std_srvs/srv/Trigger"],
        "/hexapod/drive": ["std_srvs/srv/Trigger"],
        "/hexapod/release": ["std_srvs/srv/Trigger"],
    }


def test_without_a_namespace_a_peer_asks_for_the_description_itself(gateway: Gateway) -> None:
    """In a namespace, zenoh-ros2-sdk 0.1.8 looks for a token that it does not mangle."""
    options = ("--base-frame", "base_link", "--uncommanded-deg", "45", "--joint-states-hz", "2")
    with bridged(gateway, "--ros-namespace", "/", *options) as bare, Peer(bare.endpoint) as peer:
        peer.subscribe("/robot_description", String, latched=True)
        description = peer.next("/robot_description")["data"]
        assert '<robot name="elkapod"' in description
        assert '<parent link="base_link" />' in description
        assert "/joint_states" in peer.graph()
        received = Received(bare, "joint_states", JointState)
        first, second = (received.wait(lambda _: True) for _ in range(2))
        assert len(first.name) == 18, "those that were never commanded, too"
        apart_ns = (second.header.stamp.sec - first.header.stamp.sec) * 10**9
        assert apart_ns + second.header.stamp.nanosec - first.header.stamp.nanosec > 400_000_000


def test_diagnostics_say_what_the_gateway_does(bridge: Bridge, watcher: Client) -> None:
    received = Received(bridge, "diagnostics", DiagnosticArray)

    def part(array: DiagnosticArray, name: str) -> DiagnosticStatus:
        return next(status for status in array.status if status.name == f"hexapod: {name}")

    quiet = received.wait(lambda _: True)
    assert {status.name.removeprefix("hexapod: ") for status in quiet.status} == {
        "gateway",
        "watchdog",
        "bus",
        "emergency stop",
        "lease",
        "ROS 2 bridge",
    }
    assert {status.hardware_id for status in quiet.status} == {"hexapod"}, "its namespace tells it from other robots"
    assert part(quiet, "gateway").level == DiagnosticStatus.OK
    watcher.estop()
    stopped = received.wait(lambda each: part(each, "gateway").level == DiagnosticStatus.ERROR)
    assert part(stopped, "emergency stop").message == "engaged by watcher"


def test_what_the_robot_measures_is_read_by_a_peer_and_rubbish_ends_nothing(
    bridge: Bridge, peer: Peer, watcher: Client
) -> None:
    """Published here in the gateway's place: without access control anybody may."""
    del bridge
    for topic, kind in MEASURED.items():
        peer.subscribe(f"/hexapod/{topic}", kind)
    watcher.publish(keys.TELEMETRY, {"battery": "full"})
    with measuring.measures(watcher, measuring.MEASURED):
        battery, imu, temperature, feet = (peer.next(f"/hexapod/{topic}") for topic in MEASURED)
    assert battery["percentage"] == pytest.approx(0.8)
    assert math.isnan(battery["current"])
    assert imu["header"]["frame_id"] == "base"
    assert imu["linear_acceleration"]["z"] == 9.81
    assert temperature["temperature"] == 31.5
    assert feet["data"] == list(measuring.MEASURED.feet or ())


# ---- nothing moves unasked


def test_nothing_is_taken_before_somebody_drives(bridge: Bridge, peer: Peer, watcher: Client) -> None:
    before = watcher.state().commands
    peer.advertise("/hexapod/joint_commands", JointState)
    peer.advertise("/hexapod/cmd_vel", Twist)
    received = Received(bridge, "diagnostics", DiagnosticArray)

    def counts(array: DiagnosticArray) -> dict[str, str]:
        return {each.key: each.value for each in array.status[-1].values if each.key.startswith("rejected")}

    first = counts(received.wait(lambda _: True))
    peer.publish("/hexapod/joint_commands", resting())
    peer.publish("/hexapod/cmd_vel", Twist(Vector3(0.05)))
    received.wait(
        lambda each: all(
            counts(each).get(name) != first.get(name) for name in ("rejected joint_commands", "rejected cmd_vel")
        )
    )
    assert not running(watcher)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder is None


def test_it_drives_visibly_and_until_it_is_released(peer: Peer, watcher: Client) -> None:
    assert peer.call("/hexapod/drive") == (True, "drives as ros2")
    assert watcher.state().lease.holder == "ros2"
    assert peer.call("/hexapod/drive") == (True, "it drives already")
    assert peer.call("/hexapod/release") == (True, "released")
    assert watcher.state().lease.holder is None
    with watcher.lease():
        accepted, why = peer.call("/hexapod/drive")
        assert not accepted
        assert "held by watcher" in why


def test_a_zero_velocity_starts_no_servo(driven: Bridge, peer: Peer, watcher: Client) -> None:
    received = Received(driven, "diagnostics", DiagnosticArray)
    peer.advertise("/hexapod/cmd_vel", Twist)
    for _ in range(3):
        peer.publish("/hexapod/cmd_vel", Twist())
    received.wait(lambda each: any(value.key == "taken cmd_vel" for value in each.status[-1].values))
    assert watcher.state().mode == Mode.IDLE


# ---- the emergency stop


def test_any_peer_stops_it_always(peer: Peer, bridge: Bridge, watcher: Client) -> None:
    done, what = peer.call("/hexapod/estop")
    assert done
    assert "6 Stop frames written" in what
    first = watcher.state().estop
    (reply,) = bridge.call("estop")
    assert reply.ok is not None, "of another type, without an attachment"
    assert decode(TriggerResponse, reply.ok.payload.to_bytes()).success
    assert watcher.state().estop == first + 1
    bridge.router.put("0/hexapod/estop/std_msgs::msg::dds_::Empty_/RIHS01_1", b"\x00\x01\x00\x00\x00")
    states(watcher).wait(lambda state: state.estop == first + 2)
    assert not bridge.call("estop", key="0/hexapod/estop/**"), "whoever lists what there is engages nothing"
    assert watcher.state().estop == first + 2
    assert peer.call("/hexapod/drive") == (
        False,
        "rejected: estopped: the emergency stop is engaged; reset leaves it",
    )
    assert watcher.reset().accepted


def test_a_flood_keeps_no_emergency_stop_waiting(bridge: Bridge, peer: Peer, watcher: Client) -> None:
    """Valid commands as fast as a process can put them: the bridge reads the newest, and answers beside it."""
    publisher = bridge.publisher("joint_commands", JointState)
    ended = threading.Event()

    def flood() -> None:
        message = resting()
        while not ended.is_set():
            publisher.publish(message)

    flooding = threading.Thread(target=flood)
    with rejected(bridge, "nobody has called drive"):
        flooding.start()
    first = watcher.state().estop
    try:
        for number in (1, 2, 3):
            assert peer.call("/hexapod/estop")[0]
            assert watcher.state().estop == first + number
    finally:
        ended.set()
        flooding.join()


def test_after_an_emergency_stop_and_a_reset_nothing_goes_on_by_itself(driven: Bridge, watcher: Client) -> None:
    publisher = driven.publisher("joint_commands", JointState)
    keeps(lambda: publisher.publish(resting()), lambda: len(running(watcher)) == 6)
    seen = states(watcher)
    watcher.estop()
    keeps(lambda: publisher.publish(resting()), lambda: any(state.lease.holder is None for state in seen.all))
    assert watcher.reset().accepted
    with rejected(driven, "after that nobody has called drive"):
        publisher.publish(resting())
    assert not running(watcher)
    assert watcher.state().mode == Mode.IDLE


def test_an_emergency_stop_while_nothing_moves_ends_the_driving_too(driven: Bridge, watcher: Client) -> None:
    seen = states(watcher)
    watcher.estop()
    seen.wait(lambda state: state.lease.holder is None)
    assert watcher.reset().accepted
    with rejected(driven, "an emergency stop was engaged, or the gateway started again"):
        driven.publisher("joint_commands", JointState).publish(resting())
    assert not running(watcher)


def test_a_request_without_an_attachment_drives_nothing(bridge: Bridge, watcher: Client) -> None:
    key = bridge.names.key("drive", TRIGGER_TYPE, TRIGGER_HASH)
    (reply,) = bridge.call("drive", key, payload=encode(TriggerRequest()))
    assert reply.err is not None
    assert "no attachment" in reply.err.payload.to_string()
    assert watcher.state().lease.holder is None
    asked = Attachment(41, 7, b"0123456789abcdef")
    (reply,) = bridge.call("drive", key, payload=encode(TriggerRequest()), attachment=asked.to_bytes())
    assert reply.ok is not None
    assert reply.ok.attachment is not None
    answered = Attachment.from_bytes(reply.ok.attachment.to_bytes())
    assert (answered.number, answered.gid) == (asked.number, asked.gid)


# ---- beginning and end


def test_it_ends_when_asked_and_stops_what_runs(gateway: Gateway, watcher: Client) -> None:
    """Here beside peers that know no hashes."""
    with bridged(gateway, "--drive", "--distro", "humble") as own:
        assert "/TypeHashNotSupported" in own.names.topic_key("joint_commands", JointState)
        assert watcher.state().lease.holder == "ros2", str(own.child)
        publisher = own.publisher("joint_commands", JointState)
        keeps(lambda: publisher.publish(resting()), lambda: len(running(watcher)) == 6)
        own.child.send_signal(signal.SIGINT)
        assert own.child.wait() == 0
        state: GatewayState = watcher.state()
        assert state.mode == Mode.IDLE
        assert state.lease.holder is None


def test_one_that_dies_leaves_the_legs_to_the_watchdog(gateway: Gateway, watcher: Client) -> None:
    happened = events(watcher)
    with bridged(gateway, "--drive") as own:
        publisher = own.publisher("cmd_base_height", Float64)
        publisher.publish(Float64(0.12))
        keeps(lambda: None, lambda: len(running(watcher)) == 6)
        own.child.kill()
        happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED, timeout_s=20)
    with watcher.lease(take=True):  # not waiting until it has expired
        pass


def test_a_gateway_that_was_away_is_driven_again_only_after_another_word(tmp_path: Path) -> None:
    with Gateway(tmp_path, PATIENT) as first, bridged(first, "--drive") as own, Peer(own.endpoint) as peer:
        received = Received(own, "diagnostics", DiagnosticArray)
        first.child.kill()
        received.wait(lambda each: each.status[0].level == DiagnosticStatus.STALE)
        again: dict[str, dict[str, Any]] = {**PATIENT, "zenoh": {"listen": [first.endpoint]}}
        with Gateway(tmp_path, again) as second, second.client(source="watcher") as client:
            received.wait(lambda each: each.status[0].level == DiagnosticStatus.OK)
            own.child.wait_for_output("call drive to go on", timeout_s=20)
            assert client.state().lease.holder is None
            assert peer.call("/hexapod/drive") == (True, "drives as ros2")
            assert client.state().lease.holder == "ros2"


def test_a_router_that_was_away_finds_it_again(gateway: Gateway) -> None:
    """Its tokens, topics and services are there again; only messages were lost."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as first:
        router = first.enter_context(zenoh_listening(endpoint))
        own = Bridge(gateway, endpoint, router)
        Received(own, "diagnostics", DiagnosticArray).wait(lambda _: True)
        first.close()
        with zenoh_listening(endpoint) as own.router, own, Peer(endpoint) as peer:
            Received(own, "diagnostics", DiagnosticArray).wait(lambda each: each.status[0].level == DiagnosticStatus.OK)
            assert "/hexapod/cmd_vel" in peer.graph()
            assert peer.call("/hexapod/drive") == (True, "drives as ros2")
            done, _ = peer.call("/hexapod/estop")
            assert done
            assert peer.call("/hexapod/reset")[0]


@pytest.mark.parametrize(
    ("lacks", "via", "why"),
    [("xxhash", "zenoh", "pip install 'hexapod-gateway[ros2]'"), ("rclpy", "rclpy", "needs ROS 2 for this Python")],
)
def test_without_what_it_needs_it_names_what_to_install(lacks: str, via: str, why: str) -> None:
    words = ["ros2", "--via", via]
    program = f"import sys; sys.modules['{lacks}'] = None; from gateway.cli import main; sys.argv[1:] = {words}; main()"
    child = Child([sys.executable, "-c", program], clean())
    assert child.wait(20) == 2
    child.close()
    assert why in child.stderr


def test_what_it_cannot_begin_with(gateway: Gateway) -> None:
    router = ("--router", f"tcp/127.0.0.1:{free_port()}")
    ours = ("--connect", gateway.endpoint)
    lonely = run_here("ros2", *router, *ours)
    assert lonely.returncode == 4
    assert "no ROS 2 router answers on" in lonely.stderr
    assert "rmw_zenohd" in lonely.stderr
    for arguments, why in (
        (("--distro", "foxy"), "--distro foxy is not known"),
        (("--ros-namespace", "hexapod"), "'hexapod' is no ROS namespace"),
        (("--joint-states-hz", "0"), "joint_states_hz: 0 is not between 1 and 50"),
        (("--router", gateway.endpoint), "leads to no router, where no ROS peer should be"),
    ):
        wrong = run_here("ros2", *ours, *arguments)
        assert wrong.returncode == 2, wrong
        assert why in wrong.stderr
    with zenoh_listening(router[1]), gateway.client(source="anna") as anna, anna.lease():
        assert run_here("ros2", *router, "--connect", f"tcp/127.0.0.1:{free_port()}").returncode == 4
        refused = Child([*COMMAND, "ros2", *router, *ours, "--drive"], clean())
        refused.wait_for_output("held by anna", timeout_s=20)
        refused.send_signal(signal.SIGTERM)
        assert refused.wait() == 0
        refused.close()
