"""What moves the robot through the bridge, and what stops it: joint commands, walking, several nodes."""

import itertools
import math
from functools import partial
from typing import Final

import pytest

from gateway.client import Client
from gateway.people.ros2.messages import Header, JointState, Message, Odometry, Time, Twist, Vector3
from schemas.words import Kind, Mode
from tests.support.bridged import GEOMETRY, RESTS_DEG, WALKING, commanded, keeps, rejections, resting, rests
from tests.support.heard import events, frames, running, states
from tests.support.rclpy_peer import COMMANDS, DIAGNOSTICS, RclpyPeer, needs_rclpy
from tests.support.ros2_messages import Float64, Int32, TwistStamped, replace

pytestmark = needs_rclpy
VELOCITIES: Final = "/hexapod/cmd_vel"
SIMULATED: Final = Header(Time(12, 500_000_000))
"""As a simulator's clock has it, some seconds after its start."""
MANY: Final = tuple(f"joint_{number}" for number in range(10_000))
LATE: Final = "it has a stamp of 1970-01-01"
BAD: Final[tuple[tuple[str, Message, str], ...]] = (
    ("joint_commands", JointState(name=MANY, position=(0.0,) * 10_000), "and at most 4096 are taken"),
    ("joint_commands", replace(resting(), header=SIMULATED), LATE),
    ("cmd_vel", Twist(Vector3(math.nan)), "cmd_vel: "),
    ("cmd_vel_stamped", TwistStamped(SIMULATED, Twist(Vector3(0.05))), LATE),
    ("cmd_base_height", Float64(math.nan), "a height and a leaning are finite numbers"),
    ("cmd_gait_type", Int32(77), "there is no gait 77"),
)
"""What ROS peers must not send, of each topic one or two: topic, message and what the diagnostics say.

None of it moves anything. All: tests/unit/people/test_ros2_robot.py.
"""


# ---- joint commands


@pytest.mark.parametrize("serialized", [False, True], ids=["as messages", "as serialised bytes"])
def test_joint_commands_become_frames_in_any_order_and_their_silence_stops_the_legs(
    serialized: bool, driven: RclpyPeer, watcher: Client
) -> None:
    happened, written, steps = events(watcher), frames(watcher), itertools.count()
    driven.subscribe("/hexapod/joint_states", JointState)
    publish = partial(driven.publish, serialized=serialized)

    def next_step() -> None:
        message = resting(joint_11=next(steps) / 1000)
        publish(COMMANDS, JointState(name=message.name[::-1], position=message.position[::-1]))

    keeps(next_step, lambda: len(running(watcher)) == 6)
    sent = next(steps)
    happened.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
    angles = commanded(written.all, 11)
    assert len(set(angles)) == len(angles) > 5, "each angle was sent once, so it is written once at most"
    assert len(angles) <= sent
    states(watcher).wait(lambda state: state.lease.holder is None)
    last = GEOMETRY.joint_rad(11, angles[-1])
    driven.next("/hexapod/joint_states", lambda each: bool(each.position) and abs(each.position[0] - last) < 1e-3)
    driven.not_taken(COMMANDS, resting(), "joint_commands fell silent, and the gateway has stopped its legs")
    assert not running(watcher)


def test_bad_messages_move_nothing_and_each_is_explained(driven: RclpyPeer, watcher: Client) -> None:
    before = watcher.state().commands
    driven.advertise("/hexapod/cmd_vel_stamped", TwistStamped)
    for topic, message, why in BAD:
        driven.not_taken(f"/hexapod/{topic}", message, why)
    assert watcher.state().commands == before
    assert watcher.state().lease.holder == "ros2", "it drives on"


# ---- walking


def test_a_robot_is_raised_leans_walks_and_stands_in_silence_and_what_legs_cannot_do_is_rejected(
    driven: RclpyPeer, watcher: Client
) -> None:
    """How long each silence lasts: tests/unit/people/test_ride.py."""
    driven.advertise("/hexapod/cmd_vel_stamped", TwistStamped)  # ROS 2's own teleop sends either
    driven.not_taken("/hexapod/roll_setpoint", Float64(0.1), "roll_setpoint: the robot does not stand")
    driven.not_taken("/hexapod/cmd_base_height", Float64(5.0), "cmd_base_height: it cannot stand 5 m high")
    assert not running(watcher)
    written = frames(watcher)
    driven.publish("/hexapod/cmd_base_height", Float64(0.12))
    keeps(lambda: None, lambda: rests(written, 12, 22, count=40))
    level = {leg: commanded(written.all, leg * 10 + 2)[-1] for leg in (1, 2)}
    assert level[1] + level[2] == pytest.approx(180.0, abs=0.1), "left and right servos mirror each other"
    driven.publish("/hexapod/roll_setpoint", Float64(0.1))
    keeps(lambda: None, lambda: not rests(written, 12, count=2))
    driven.publish("/hexapod/cmd_gait_type", Int32(1))
    driven.subscribe("/hexapod/odom", Odometry)
    seen: set[float] = set()

    def walked() -> bool:
        seen.update(commanded(written.all[-60:], 11))
        return len(seen) > 60

    stamped = TwistStamped(twist=WALKING)
    keeps(lambda: driven.publish("/hexapod/cmd_vel_stamped", stamped), walked, hz=20)
    went = driven.next("/hexapod/odom", lambda each: each.pose.pose.position.x > 0.01)
    assert (went.header.frame_id, went.child_frame_id) == ("odom", "base")
    assert all(went.pose.covariance[each] > 0 and went.twist.covariance[each] > 0 for each in (0, 7, 35))
    keeps(lambda: None, lambda: rests(written, 11, 12, 22, count=50))
    leans = {leg: commanded(written.all, leg * 10 + 2)[-1] for leg in (1, 2)}
    assert leans[1] + leans[2] != pytest.approx(180.0, abs=1.0)
    assert len(running(watcher)) == 6
    assert driven.call("/hexapod/release") == (True, "released")
    assert watcher.state().mode == Mode.IDLE


def test_a_node_that_sends_zeros_starts_no_servo_and_beside_it_another_drives(
    driven: RclpyPeer, watcher: Client
) -> None:
    with RclpyPeer() as idle:
        idle.advertise(VELOCITIES, Twist)

        def taken(array: Message) -> bool:
            idle.publish(VELOCITIES, Twist())
            return any(value.key == "taken cmd_vel" for value in array.status[-1].values)

        def both() -> None:
            idle.publish(VELOCITIES, Twist())
            driven.publish(VELOCITIES, WALKING)

        driven.next(DIAGNOSTICS, taken)
        assert watcher.state().mode == Mode.IDLE
        keeps(both, lambda: len(running(watcher)) == 6, hz=20)


# ---- several nodes


def test_of_two_nodes_that_fight_the_first_is_followed(driven: RclpyPeer, watcher: Client) -> None:
    """Until it is silent: tests/unit/people/test_ros2_robot.py."""
    written = frames(watcher)
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
        driven.next(DIAGNOSTICS, lambda each: rejections(each) == rejected)
