"""What moves the robot through the bridge, and what stops it: joint commands, walking, trajectories."""

import itertools
import math
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest
from rosbags.rosbag2 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from gateway.client import Client
from gateway.people.bridge.driving import Driving
from gateway.people.ros2.cdr import encode
from gateway.people.ros2.joints import JointNames
from gateway.people.ros2.messages import (
    Duration,
    Float64,
    Int32,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    TFMessage,
    Twist,
    TwistStamped,
    Vector3,
)
from gateway.people.ros2.trajectory import Trajectory
from schemas.telemetry import FrameRecord, Kind, Mode
from tests.support.bridged import (
    GEOMETRY,
    LONG_S,
    RESTS_DEG,
    Bridge,
    Received,
    bridged,
    clean,
    commanded,
    keeps,
    rejected,
    resting,
)
from tests.support.child import Child
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, frames, running, states
from tests.support.ros2_peer import Peer

EXAMPLES: Final = Path(__file__).parents[2] / "examples/ros2"

# ---- joint commands


def test_joint_commands_become_frames_in_any_order_of_joints(driven: Bridge, peer: Peer, watcher: Client) -> None:
    seen = Received(driven, "joint_states", JointState)
    message = resting(joint_11=0.1)
    turned = JointState(name=message.name[::-1], position=message.position[::-1])
    peer.advertise("/hexapod/joint_commands", JointState)
    keeps(lambda: peer.publish("/hexapod/joint_commands", turned), lambda: running(watcher) == [1, 2, 3, 4, 5, 6])
    angles = {servo.id: servo.angle_deg for leg in watcher.state().legs for servo in leg.servos}
    assert angles[11] == pytest.approx(GEOMETRY.servos[11].servo_deg(message.position[0]), abs=0.006)
    assert angles[62] == RESTS_DEG[2]
    assert seen.wait(lambda each: each.position == pytest.approx(message.position, abs=1e-4)).name == message.name
    assert Received(driven, "/tf", TFMessage).wait(lambda each: len(each.transforms) == 24)


def test_a_topic_that_falls_silent_is_never_repeated(driven: Bridge, watcher: Client) -> None:
    happened, written = events(watcher), frames(watcher)
    publisher = driven.publisher("joint_commands", JointState)
    steps = itertools.count()
    keeps(lambda: publisher.publish(resting(joint_11=next(steps) / 1000)), lambda: len(running(watcher)) == 6)
    sent = next(steps)
    happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
    angles = commanded(written.all, 11)
    assert len(set(angles)) == len(angles) > 5, "each angle was sent once, so it is written once at most"
    assert len(angles) <= sent
    states(watcher).wait(lambda state: state.lease.holder is None)
    with rejected(driven, "joint_commands fell silent, and the gateway has stopped its legs"):
        publisher.publish(resting())
    assert not running(watcher)


def test_what_a_link_held_back_is_not_taken(driven: Bridge, watcher: Client) -> None:
    publisher = driven.publisher("joint_commands", JointState)
    late_ns = 3_000_000_000
    with rejected(driven, "joint_commands: the command was delayed for"):
        keeps(lambda: publisher.publish(resting()), lambda: len(running(watcher)) == 6)
        publisher.publish(resting(joint_11=0.5), sent_ns=time.time_ns() - late_ns)
    angle_deg = watcher.state().legs[0].servos[0].angle_deg
    assert angle_deg == RESTS_DEG[1]


def test_a_bag_that_rosbags_has_written_is_played(driven: Bridge, watcher: Client, tmp_path: Path) -> None:
    recorded = written_by_rosbags(tmp_path / "bag")
    written, publisher, played = frames(watcher), driven.publisher("joint_commands", JointState), iter(recorded)
    keeps(lambda: publisher.put(next(played, recorded[-1])), lambda: commanded(written.all, 11)[-1:] == [LAST_DEG])
    assert len(set(commanded(written.all, 11))) > 5


def written_by_rosbags(path: Path) -> list[bytes]:
    """What a bag has of joint commands, with bytes behind the last field, as ROS 2's own recorder keeps them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9) as writer:
        connection = writer.add_connection("/hexapod/joint_commands", JointState.TYPE, typestore=store)
        for number in range(50):
            message = store.deserialize_cdr(encode(resting(joint_11=number / 1000)), JointState.TYPE)
            data = bytes(store.serialize_cdr(message, JointState.TYPE)) + bytes(8)
            writer.write(connection, number * 20_000_000, data)
    with Reader(path) as reader:
        return [bytes(data) for _, _, data in reader.messages()]


LAST_DEG: Final = round(RESTS_DEG[1] + math.degrees(0.049), 2)


# ---- walking


def rests(written: Heard[FrameRecord], *servos: int, count: int) -> bool:
    """Whether the newest `count` angles of each of these are the same."""
    newest = [commanded(written.all[-10 * count :], servo_id)[-count:] for servo_id in servos]
    return all(len(angles) == count and len(set(angles)) == 1 for angles in newest)


def strides(written: Heard[FrameRecord]) -> bool:
    """Whether leg 1 has swung lately."""
    return len(set(commanded(written.all[-400:], 11))) > 20


def test_it_is_raised_leans_walks_and_stands_in_silence_and_what_legs_cannot_do_is_not_taken(
    driven: Bridge, peer: Peer, watcher: Client
) -> None:
    """How long each silence lasts: tests/unit/people/test_ride.py."""
    for topic in ("roll_setpoint", "pitch_setpoint", "cmd_base_height"):
        peer.advertise(f"/hexapod/{topic}", Float64)
    peer.advertise("/hexapod/cmd_gait_type", Int32)
    velocities = driven.publisher("cmd_vel", TwistStamped)  # ROS 2's own teleop sends either
    with rejected(driven, "roll_setpoint: the robot does not stand"):
        peer.publish("/hexapod/roll_setpoint", Float64(0.1))
    with rejected(driven, "cmd_base_height: it cannot stand 5 m high"):
        peer.publish("/hexapod/cmd_base_height", Float64(5.0))
    with rejected(driven, "cmd_base_height: a height and a leaning are finite numbers"):
        peer.publish("/hexapod/cmd_base_height", Float64(math.nan))
    assert not running(watcher)
    written = frames(watcher)
    peer.publish("/hexapod/cmd_base_height", Float64(0.12))
    keeps(lambda: None, lambda: rests(written, 12, 22, count=40))
    level = {leg: commanded(written.all, leg * 10 + 2)[-1] for leg in (1, 2)}
    assert level[1] + level[2] == pytest.approx(180.0, abs=0.1), "left and right servos mirror each other"
    peer.publish("/hexapod/roll_setpoint", Float64(0.1))
    keeps(lambda: None, lambda: not rests(written, 12, count=2))
    peer.publish("/hexapod/cmd_gait_type", Int32(1))
    seen: set[float] = set()

    def walked() -> bool:
        seen.update(commanded(written.all[-60:], 11))
        return len(seen) > 60

    keeps(lambda: velocities.publish(TwistStamped(twist=Twist(Vector3(0.05)))), walked, hz=20)
    keeps(lambda: None, lambda: rests(written, 11, 12, 22, count=50))
    leans = {leg: commanded(written.all, leg * 10 + 2)[-1] for leg in (1, 2)}
    assert leans[1] + leans[2] != pytest.approx(180.0, abs=1.0)
    assert len(running(watcher)) == 6
    assert peer.call("/hexapod/release") == (True, "released")
    assert watcher.state().mode == Mode.IDLE


def test_the_example_without_ros_walks(bridge: Bridge, watcher: Client) -> None:
    written = frames(watcher)
    command = [sys.executable, str(EXAMPLES / "walk_without_ros.py"), bridge.endpoint.rpartition(":")[2]]
    example = Child(command, clean() | {"GIT_PYTHON_REFRESH": "quiet"})
    assert example.wait(LONG_S) == 0, example
    example.close()
    assert example.stdout == "drive: drives as ros2\nrelease: released\n"
    assert len(set(commanded(written.all, 11))) > 20
    assert watcher.state().mode == Mode.IDLE


# ---- trajectories


def plan(*points: tuple[float, float]) -> JointTrajectory:
    """Seconds and radians of joint_11; the others stay."""
    found = []
    for at_s, moved_rad in points:
        state = resting(joint_11=moved_rad)
        whole, part = divmod(at_s, 1)
        found.append(JointTrajectoryPoint(state.position, time_from_start=Duration(int(whole), int(part * 1e9))))
    return JointTrajectory(joint_names=resting().name, points=tuple(found))


@pytest.mark.parametrize("dies", [True, False], ids=["the SDK's process dies", "its token goes"])
def test_a_peer_that_vanishes_in_mid_trajectory_has_the_robot_sit_down(
    dies: bool, driven: Bridge, watcher: Client
) -> None:
    """Also one whose GID is not its token's (the SDK's); another publisher makes no difference."""
    written = frames(watcher)
    raw = driven.publisher("joint_trajectory", JointTrajectory)
    slow = plan((0.5, 0.0), (50.0, 1.0))
    with Peer(driven.endpoint) as vanishing:
        vanishing.advertise("/hexapod/joint_trajectory", JointTrajectory)
        if dies:
            vanishing.publish("/hexapod/joint_trajectory", slow)
        else:
            raw.publish(slow)
        keeps(lambda: None, lambda: len(set(commanded(written.all, 11))) > 5)
        if dies:
            vanishing.child.kill()
        else:
            raw.vanish()
        states(watcher).wait(lambda state: state.mode == Mode.IDLE, timeout_s=LONG_S)
    raw.vanish()
    assert max(commanded(written.all, 11)) < 90 + 57, "it did not follow it to its end"
    assert watcher.state().lease.holder == "ros2", "another may go on"


def test_a_trajectory_behind_one_that_has_just_ended_is_followed(gateway: Gateway, watcher: Client) -> None:
    """Here nobody looks whether it has ended; the bridge does twenty times a second."""
    happened, gone = events(watcher), threading.Event()
    leg = replace(plan((30.0, 0.0)), joint_names=resting().name[:3])
    leg = replace(leg, points=(replace(leg.points[0], positions=leg.points[0].positions[:3]),))
    with gateway.client(source="ros2") as client:
        driving = Driving(client, "ros2", GEOMETRY, lambda _: None)
        driving.activate()
        driving.drive()
        first, then = (Trajectory.read(leg, JointNames(), GEOMETRY, time.monotonic(), time.time_ns()) for _ in range(2))
        driving.follow(first, lambda: not gone.is_set())
        states(watcher).wait(lambda state: state.mode == Mode.ACTIVE)
        gone.set()
        driving.check()  # with one leg nothing can sit down
        happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
        driving.follow(then, lambda: True)
        states(watcher).wait(lambda state: state.mode == Mode.ACTIVE)
        driving.close()
    assert watcher.state().mode == Mode.IDLE


def test_a_sender_that_nobody_sees_is_not_followed(gateway: Gateway, watcher: Client) -> None:
    with bridged(gateway, "--drive") as own:
        publisher = own.publisher("joint_trajectory", JointTrajectory, is_seen=False)
        with rejected(own, "joint_trajectory: its sender is not seen in the graph"):
            publisher.publish(plan((1.0, 0.1)))
    assert not running(watcher)


def test_one_kind_of_motion_at_a_time(driven: Bridge, peer: Peer, watcher: Client) -> None:
    publisher = driven.publisher("joint_commands", JointState)
    keeps(lambda: publisher.publish(resting()), lambda: len(running(watcher)) == 6)
    peer.advertise("/hexapod/cmd_vel", Twist)
    with rejected(driven, "cmd_vel: joint_commands moves the robot"):
        peer.publish("/hexapod/cmd_vel", Twist(Vector3(0.05)))
