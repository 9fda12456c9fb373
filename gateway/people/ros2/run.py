"""`ros2`: a session to the gateway, a node in ROS 2's graph, and the way from one to the other until the end."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, UnansweredError
from gateway.geometry import load
from gateway.own_command import install
from gateway.people.client.subscriptions import subscribed
from gateway.people.commands.reach import Connection
from gateway.people.ros2.driving import Driving
from gateway.people.ros2.parameters import Parameters
from gateway.people.ros2.trajectory import JointNames, JointsError
from gateway.people.terminal import hint, on_end_signals, say

try:
    from gateway.people.ros2.follow_action import NAME, FollowAction
    from gateway.people.ros2.node import Node
    from gateway.people.ros2.reports import CHANNELS, PERIOD_S, Reports
    from gateway.people.ros2.topics import Topics
except ImportError as error:
    raise ConfigError(
        "the command ros2 needs ROS 2 for this Python: source its setup.bash, or "
        f"{install('rclpy')} (docs/ros2.md; {error})"
    ) from error

_NAME: Final = "ros2"
OPEN_NAME: Final = "ros2 (open graph)"
"""The driver's name in state and events if other machines may reach the graph."""
WATCH_S: Final = 0.05


def serve(
    connect: Callable[[str], Connection],
    *,
    ros_args: list[str],
    domain: int,
    namespace: str,
    joint_names: str,
    parameters: Parameters,
    drives: bool,
    allow_reset: bool,
    with_tf: bool,
    geometry: Path | None,
) -> int:
    """Serve until a signal; `connect` takes the name by which the gateway knows us. Returns the exit code.

    Raises ConfigError, ZenohError.
    """
    try:
        joints = JointNames(joint_names)
    except JointsError as error:
        raise ConfigError(f"--joint-names: {error}") from error
    shape = load(geometry)
    ended = threading.Event()
    with closing(Node(domain, namespace, ros_args)) as node:
        if is_open := bool(found := node.open_on()):
            hint(
                f"ROS 2's graph is open to the network ({node.rmw} has sockets on {', '.join(found)}): all who reach "
                "it can drive the robot. To keep it on this machine: docs/ros2.md#who-reaches-the-graph"
            )
        name = OPEN_NAME if is_open else _NAME
        with connect(name)() as client, on_end_signals(ended.set), ExitStack() as at_the_end:
            driving = Driving(client, name, shape, hint)
            at_the_end.callback(node.close)
            topics = Topics(node, driving, shape, joints, hint)
            node.serve("estop", driving.estop, always=True)
            received = at_the_end.enter_context(subscribed(client.session, CHANNELS))
            channels = dict(zip(CHANNELS, received, strict=True))
            shown = node.parameters(parameters)
            robot = namespace.strip("/") or node.get_name()
            reports = Reports(
                channels,
                node,
                shape,
                driving,
                topics,
                shown,
                client.states,
                hardware_id=robot,
                with_tf=with_tf,
                is_open=is_open,
            )
            with suppress(UnansweredError):  # an older gateway has none
                reports.begin(client.calibration())
            topics.subscribe()
            try:
                FollowAction(node, driving, topics)
            except ConfigError as error:
                hint(f"no action {NAME}: {error}")
            node.serve("reset", partial(driving.reset, of_anybody=allow_reset))
            node.serve("drive", driving.drive)
            node.serve("release", driving.release)
            watch = threading.Thread(target=_watch, args=(ended, driving), name="watch the motion", daemon=True)
            watch.start()
            at_the_end.callback(watch.join)
            at_the_end.callback(ended.set)
            at_the_end.callback(driving.close)  # first: its legs are stopped before it waits for anything
            node.manage(partial(driving.activate, drives=drives), driving.deactivate)
            say(f"{node.get_fully_qualified_name()} is in ROS 2's graph of {node.rmw}, domain {domain}; Ctrl-C ends")
            while not ended.wait(PERIOD_S):
                topics.record_alive()
                reports.tick(time.monotonic())
    return 0


def _watch(ended: threading.Event, driving: Driving) -> None:
    while not ended.wait(WATCH_S):
        driving.check()
