"""`ros2`: the two sessions, what is between them, and the end."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

import zenoh

from gateway.errors import ConfigError, RejectedError, UnansweredError
from gateway.geometry import load
from gateway.people.bridge.driving import Driving
from gateway.people.client.requests import Identity
from gateway.people.client.subscriptions import subscribed
from gateway.people.ros2.messages import DISTRIBUTIONS
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.tools.reach import Connection
from gateway.text import visible
from gateway.zenoh_config import client_config, connect_endpoints

try:
    from gateway.people.bridge.graph import check_closed
    from gateway.people.bridge.node import Node, Senders, check_apart, open_router
    from gateway.people.bridge.reports import CHANNELS, PERIOD_S, Reports
    from gateway.people.bridge.topics import Topics
    from gateway.people.ros2.wire import Names, WireError
except ImportError as error:
    raise ConfigError("the ROS 2 bridge needs: pip install 'hexapod-gateway[ros2]'") from error

NAME: Final = "ros2"
OPEN_NAME: Final = "ros2 (open graph)"
"""Where others reach the router without certificates: so the gateway's state and events name whoever drives by it."""
ROUTER: Final = "tcp/localhost:7447"
NODE: Final = "hexapod_gateway"
WITHOUT_HASHES: Final = ("humble",)
WATCH_S: Final = 0.05


def serve(
    connect: Callable[..., Connection],
    *,
    router: str | None,
    router_config: Path | None,
    domain: int,
    namespace: str,
    distribution: str,
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
    except WireError as error:
        raise ConfigError(f"--ros-namespace: {error}") from error
    shape = load(geometry)
    config = client_config(router or (None if router_config else ROUTER), router_config)
    ended = threading.Event()
    with open_router(config) as session:
        is_open = _is_open(config, session, accepted=open_graph)
        name = OPEN_NAME if is_open else NAME
        with connect(source=name)() as client, on_end_signals(ended.set), ExitStack() as at_the_end:
            check_apart(session, client)
            driving = Driving(client, name, shape, _show)
            senders = Senders(session, names, "joint_trajectory")
            at_the_end.callback(senders.close)
            topics = Topics(driving, shape, names, senders, _show)
            node = Node(session, names)
            at_the_end.callback(node.close)
            node.serve("estop", lambda: _estop(driving), always=True)
            received = at_the_end.enter_context(subscribed(client.session, CHANNELS))
            channels = dict(zip(CHANNELS, received, strict=True))
            reports = Reports(channels, node, shape, driving, topics, with_tf=with_tf, is_open=is_open)
            with suppress(UnansweredError):  # an older gateway has none
                reports.begin(client.calibration())
            for topic, (kind, take) in topics.table().items():
                node.subscribe(topic, kind, take)
            node.serve("reset", lambda: _reset(driving, of_anybody=allow_reset))
            node.serve("drive", driving.drive)
            node.serve("release", driving.release)
            watch = threading.Thread(target=_watch, args=(ended, driving), name="watch the motion", daemon=True)
            watch.start()
            at_the_end.callback(watch.join)
            at_the_end.callback(ended.set)
            at_the_end.callback(driving.close)  # first: what it moves is stopped before anything is waited for
            if drives:
                _drive(driving)
            where = ", ".join(connect_endpoints(config))
            say(f"{names.full(NODE)} is in ROS 2's graph of {where}, domain {domain}, as {distribution}; Ctrl-C ends")
            while not ended.wait(PERIOD_S):
                topics.turned()
                reports.tick(time.monotonic())
    return 0


def _watch(ended: threading.Event, driving: Driving) -> None:
    while not ended.wait(WATCH_S):
        driving.check()


def _drive(driving: Driving) -> None:
    try:
        driving.drive()
    except RejectedError as error:
        hint(visible(f"--drive: {error}; the service drive tries again"))


def _is_open(config: zenoh.Config, session: zenoh.Session, *, accepted: bool) -> bool:
    """Whether others reach the router without certificates. Raises ConfigError unless that is accepted."""
    try:
        for endpoint in connect_endpoints(config):
            check_closed(endpoint, session, Identity.of(config))
    except ConfigError as error:
        if not accepted:
            raise
        hint(visible(f"--open-graph: {error}"))
        return True
    return False


def _estop(driving: Driving) -> str:
    ack = driving.estop()
    return f"emergency stop {ack.estop}: {ack.stop_frames} Stop frames written within {ack.latency_us:.0f} µs"


def _reset(driving: Driving, *, of_anybody: bool) -> str:
    driving.reset(of_anybody=of_anybody)
    return "the emergency stop is left; nothing moves until it is started again"


def _show(text: str) -> None:
    hint(visible(text))


def _all(names: tuple[str, ...]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}"
