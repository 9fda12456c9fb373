"""`ros2`: a session to the gateway, a node in ROS 2's graph, and the way from one to the other until the end."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, GatewayError, RejectedError, UnansweredError
from gateway.geometry import load
from gateway.people.bridge.driving import Driving
from gateway.people.bridge.parameters import Parameters
from gateway.people.bridge.reports import CHANNELS, PERIOD_S, Reports
from gateway.people.bridge.topics import Topics
from gateway.people.client.dangers import UNCONFIRMED, confirmed_off
from gateway.people.client.subscriptions import subscribed
from gateway.people.commands.reach import Connection
from gateway.people.ros2.joints import JointNames, JointsError
from gateway.people.terminal import hint, on_end_signals, say
from gateway.text import visible

try:
    from gateway.people.bridge.follow_action import NAME, FollowAction
    from gateway.people.bridge.node import Node
except ImportError as error:
    raise ConfigError(
        "the command ros2 needs ROS 2 for this Python: source its setup.bash, or pip install "
        f"'hexapod-gateway[rclpy]' (docs/ros2.md; {error})"
    ) from error

_NAME: Final = "ros2"
OPEN_NAME: Final = "ros2 (open graph)"
"""Where other machines may reach the graph: the gateway's state and events show it by this name."""
WATCH_S: Final = 0.05


def serve(
    connect: Callable[..., Connection],
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
        is_open = _is_open(node)
        name = OPEN_NAME if is_open else _NAME
        with connect(source=name)() as client, on_end_signals(ended.set), ExitStack() as at_the_end:
            driving = Driving(client, name, shape, _show)
            at_the_end.callback(node.close)
            topics = Topics(driving, shape, joints, node.senders("joint_trajectory"), _show)
            node.serve("estop", lambda: _estop(driving), always=True)
            received = at_the_end.enter_context(subscribed(client.session, CHANNELS))
            channels = dict(zip(CHANNELS, received, strict=True))
            settings = node.parameters(parameters)
            reports = Reports(
                channels,
                node,
                shape,
                joints,
                driving,
                topics,
                settings,
                hardware_id=namespace.strip("/") or node.get_name(),
                with_tf=with_tf,
                is_open=is_open,
            )
            with suppress(UnansweredError):  # an older gateway has none
                reports.begin(client.calibration())
            topics.subscribe(node)
            try:
                FollowAction(node, driving, shape, joints, topics)
            except ConfigError as error:
                hint(f"no action {NAME}: {error}")
            node.serve("reset", lambda: _reset(driving, of_anybody=allow_reset))
            node.serve("drive", driving.drive)
            node.serve("release", driving.release)
            watch = threading.Thread(target=_watch, args=(ended, driving), name="watch the motion", daemon=True)
            watch.start()
            at_the_end.callback(watch.join)
            at_the_end.callback(ended.set)
            at_the_end.callback(driving.close)  # first: what it moves is stopped before anything is waited for
            node.manage(partial(_activate, driving, drives=drives), partial(_deactivate, driving))
            say(f"{node.get_fully_qualified_name()} is in ROS 2's graph of {node.rmw}, domain {domain}; Ctrl-C ends")
            while not ended.wait(PERIOD_S):
                topics.turned()
                reports.tick(time.monotonic())
    return 0


def _watch(ended: threading.Event, driving: Driving) -> None:
    while not ended.wait(WATCH_S):
        driving.check()


def _activate(driving: Driving, *, drives: bool) -> None:
    driving.activate()
    if drives:
        try:
            driving.drive()
        except RejectedError as error:
            hint(visible(f"--drive: {error}; the service drive tries again"))


def _deactivate(driving: Driving, why: str) -> None:
    try:
        driving.deactivate(why)
    except GatewayError as error:  # what cannot be stopped from here is stopped by the gateway's watchdog
        hint(visible(f"{why}: {error}"))


def _is_open(node: Node) -> bool:
    """Whether other machines may reach the node; a person is then shown how to keep it on this one."""
    found = node.open_on()
    if found:
        sockets = f"{node.rmw} has sockets on {', '.join(found)}"
        hint(
            f"ROS 2's graph is open to the network ({sockets}): all who reach it can drive the robot. To keep it on "
            "this machine: docs/ros2.md#who-reaches-the-graph"
        )
    return bool(found)


def _estop(driving: Driving) -> str:
    ack = driving.estop()
    within = f"within {ack.latency_us:.0f} µs{confirmed_off(ack)}{f'. {UNCONFIRMED}' if ack.confirmed is False else ''}"
    return f"emergency stop {ack.estop}: {ack.stop_frames} Stop frames written {within}"


def _reset(driving: Driving, *, of_anybody: bool) -> str:
    driving.reset(of_anybody=of_anybody)
    return "the emergency stop is left; nothing moves until it is started again"


def _show(text: str) -> None:
    hint(visible(text))
