"""`ros2`: a session to the gateway, a node in ROS 2's graph, and the way from one to the other until the end."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, GatewayError, RejectedError, UnansweredError
from gateway.geometry import Geometry, load
from gateway.people.bridge.driving import Driving
from gateway.people.bridge.graph import Graph
from gateway.people.bridge.parameters import Parameters
from gateway.people.client.dangers import UNCONFIRMED, confirmed_off
from gateway.people.client.subscriptions import subscribed
from gateway.people.ros2.joints import JointNames, JointsError
from gateway.people.ros2.messages import DISTRIBUTIONS
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.tools.reach import Connection
from gateway.text import visible
from gateway.zenoh_config import client_config

try:
    from gateway.people.bridge.follow_action import NAME, FollowAction
    from gateway.people.bridge.reports import CHANNELS, PERIOD_S, Reports
    from gateway.people.bridge.topics import Topics
    from gateway.people.bridge.zenoh_graph import ZenohGraph, open_router
    from gateway.people.ros2.wire import Names, WireError
except ImportError as error:
    raise ConfigError("the ROS 2 bridge needs: pip install 'hexapod-gateway[ros2]'") from error

_NAME: Final = "ros2"
OPEN_NAME: Final = "ros2 (open graph)"
"""Where others reach the graph without certificates: the gateway's state and events show it by this name."""
ROUTER: Final = "tcp/localhost:7447"
NODE: Final = "hexapod_gateway"
WITHOUT_HASHES: Final = ("humble",)
WATCH_S: Final = 0.05


def serve(
    connect: Callable[..., Connection],
    *,
    by_rclpy: bool,
    ros_args: list[str],
    router: str | None,
    router_config: Path | None,
    domain: int,
    namespace: str,
    distribution: str,
    joint_names: str,
    parameters: Parameters,
    drives: bool,
    allow_reset: bool,
    open_graph: bool,
    with_tf: bool,
    geometry: Path | None,
) -> int:
    """Serve until a signal; `connect` takes the name by which the gateway knows us. Returns the exit code.

    Raises ConfigError, ZenohError.
    """
    if distribution not in DISTRIBUTIONS:
        raise ConfigError(f"--distro {distribution} is not known; the message types are those of {_all(DISTRIBUTIONS)}")
    try:
        names = Names(domain, namespace, NODE, hashes=distribution not in WITHOUT_HASHES)
        joints = JointNames(joint_names)
    except WireError as error:
        raise ConfigError(f"--ros-namespace: {error}") from error
    except JointsError as error:
        raise ConfigError(f"--joint-names: {error}") from error
    shape = load(geometry)
    ended = threading.Event()
    opened = _open_rclpy if by_rclpy else _open_zenoh
    with closing(opened(names, router, router_config, ros_args)) as graph:
        is_open = _is_open(graph, accepted=open_graph)
        name = OPEN_NAME if is_open else _NAME
        with connect(source=name)() as client, on_end_signals(ended.set), ExitStack() as at_the_end:
            graph.check_apart(client)
            driving = Driving(client, name, shape, _show)
            at_the_end.callback(graph.close)
            topics = Topics(driving, shape, joints, graph.senders("joint_trajectory"), _show)
            graph.serve("estop", lambda: _estop(driving), always=True)
            received = at_the_end.enter_context(subscribed(client.session, CHANNELS))
            channels = dict(zip(CHANNELS, received, strict=True))
            settings = graph.parameters(parameters)
            reports = Reports(
                channels,
                graph,
                shape,
                joints,
                driving,
                topics,
                settings,
                hardware_id=namespace.strip("/") or NODE,
                with_tf=with_tf,
                is_open=is_open,
            )
            with suppress(UnansweredError):  # an older gateway has none
                reports.begin(client.calibration())
            topics.subscribe(graph)
            action = _action(graph, driving, shape, joints, topics)
            at_the_end.callback(action)  # what it followed has been stopped then, and its goal ends with that
            graph.serve("reset", lambda: _reset(driving, of_anybody=allow_reset))
            graph.serve("drive", driving.drive)
            graph.serve("release", driving.release)
            watch = threading.Thread(target=_watch, args=(ended, driving), name="watch the motion", daemon=True)
            watch.start()
            at_the_end.callback(watch.join)
            at_the_end.callback(ended.set)
            at_the_end.callback(driving.close)  # first: what it moves is stopped before anything is waited for
            graph.manage(partial(_activate, driving, drives=drives), partial(_deactivate, driving))
            say(f"{names.full(NODE)} is in ROS 2's graph of {graph.where}, domain {domain}; Ctrl-C ends")
            while not ended.wait(PERIOD_S):
                topics.turned()
                reports.tick(time.monotonic())
                action()
    return 0


def _open_zenoh(names: Names, router: str | None, router_config: Path | None, ros_args: list[str]) -> Graph:
    if ros_args:
        raise ConfigError(f"{' '.join(ros_args)}: ROS 2's own arguments are for --via rclpy")
    config = client_config(router or (None if router_config else ROUTER), router_config)
    return ZenohGraph(config, open_router(config), names)


def _open_rclpy(names: Names, router: str | None, router_config: Path | None, ros_args: list[str]) -> Graph:
    if router is not None or router_config is not None:
        raise ConfigError("--router and --router-config are for --via zenoh")
    try:
        from gateway.people.bridge.rclpy_graph import RclpyGraph
    except ImportError as error:
        raise ConfigError(
            f"--via rclpy needs ROS 2 for this Python: source its setup.bash, or see docs/ros2.md ({error})"
        ) from error
    return RclpyGraph(names, ros_args)


def _action(graph: Graph, driving: Driving, shape: Geometry, joints: JointNames, topics: Topics) -> Callable[[], None]:
    """Serve the action, where the graph has its types; returns its tick."""
    try:
        return FollowAction(graph, driving, shape, joints, topics).tick
    except ConfigError as error:
        hint(visible(f"no action {NAME}: {error}"))
        return lambda: None


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


def _is_open(graph: Graph, *, accepted: bool) -> bool:
    """Whether others reach the graph without certificates. Raises ConfigError unless that is accepted."""
    try:
        graph.check_closed()
    except ConfigError as error:
        if not accepted:
            raise
        hint(visible(f"--open-graph: {error}"))
        return True
    return False


def _estop(driving: Driving) -> str:
    ack = driving.estop()
    within = f"within {ack.latency_us:.0f} µs{confirmed_off(ack)}{f'. {UNCONFIRMED}' if ack.confirmed is False else ''}"
    return f"emergency stop {ack.estop}: {ack.stop_frames} Stop frames written {within}"


def _reset(driving: Driving, *, of_anybody: bool) -> str:
    driving.reset(of_anybody=of_anybody)
    return "the emergency stop is left; nothing moves until it is started again"


def _show(text: str) -> None:
    hint(visible(text))


def _all(names: tuple[str, ...]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}"
