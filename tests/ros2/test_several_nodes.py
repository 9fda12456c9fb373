"""Several nodes of a graph over Zenoh: two that fight, one that is killed, many that come and go.

By rclpy: test_rclpy.
"""

import itertools
import threading

from gateway.client import Client
from gateway.people.ros2.messages import DiagnosticArray, JointState, Twist, Vector3
from schemas.telemetry import Kind, Mode
from tests.ros2.test_motion import rests, strides
from tests.support.bridged import LONG_S, RESTS_DEG, Bridge, Received, commanded, keeps, resting
from tests.support.heard import events, frames, running, states
from tests.support.ros2_peer import Peer

WALKING = Twist(Vector3(0.05))
COMMANDS, VELOCITIES = "/hexapod/joint_commands", "/hexapod/cmd_vel"


def test_of_two_nodes_that_fight_the_first_is_followed(driven: Bridge, peer: Peer, watcher: Client) -> None:
    """Until it is silent for 0.5 s: tests/unit/people/test_ros2_rivals.py."""
    first, written = driven.publisher("joint_commands", JointState), frames(watcher)
    received = Received(driven, "diagnostics", DiagnosticArray)
    peer.advertise(COMMANDS, JointState)
    keeps(lambda: first.publish(resting()), lambda: len(running(watcher)) == 6)
    steps = itertools.count()

    def both() -> None:
        first.publish(resting())
        peer.publish(COMMANDS, resting(joint_11=0.2))

    keeps(both, lambda: next(steps) > 50)
    assert set(commanded(written.all, 11)) == {RESTS_DEG[1]}
    received.wait(lambda each: any("another node publishes here" in value.value for value in each.status[-1].values))


def test_a_peer_that_is_killed_in_mid_walk_leaves_a_robot_that_stands_and_then_sits(
    driven: Bridge, watcher: Client
) -> None:
    written = frames(watcher)
    with Peer(driven.endpoint) as walking:
        walking.advertise(VELOCITIES, Twist)
        keeps(lambda: walking.publish(VELOCITIES, WALKING), lambda: strides(written), hz=20)
        walking.child.kill()
        keeps(lambda: None, lambda: rests(written, 11, 12, 22, count=50))
        assert len(running(watcher)) == 6, "it stands"
        states(watcher).wait(lambda state: state.mode == Mode.IDLE, timeout_s=LONG_S)
    assert watcher.state().lease.holder == "ros2", "another may go on"


def test_nodes_that_come_and_go_ten_times_a_second_disturb_no_walk(driven: Bridge, peer: Peer, watcher: Client) -> None:
    happened, written = events(watcher), frames(watcher)
    peer.advertise(VELOCITIES, Twist)
    pause = threading.Event()

    def churn() -> None:
        for _ in range(50):
            coming = driven.publisher("cmd_vel", Twist)
            pause.wait(0.1)
            coming.vanish()

    thread = threading.Thread(target=churn)
    keeps(lambda: peer.publish(VELOCITIES, WALKING), lambda: strides(written), hz=20)
    thread.start()
    keeps(lambda: peer.publish(VELOCITIES, WALKING), lambda: not thread.is_alive(), hz=20)
    thread.join()
    assert strides(written), "it walks"
    assert len(running(watcher)) == 6
    assert not [each for each in happened.all if each.kind in (Kind.WATCHDOG_EXPIRED, Kind.LEASE_RELEASED)]
