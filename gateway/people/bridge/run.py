"""`ros2`: the two sessions, what is between them, and the end."""

import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, GatewayError, RejectedError, UnansweredError
from gateway.geometry import load
from gateway.people.bridge.driving import Driving
from gateway.people.client.blocking import Client
from gateway.people.client.live import subscribed
from gateway.people.ros2.messages import DISTRIBUTIONS
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.tools.reach import Connection
from gateway.text import visible

try:
    from gateway.people.bridge.node import Node, Senders, open_router
    from gateway.people.bridge.reports import CHANNELS, PERIOD_S, Reports
    from gateway.people.bridge.topics import Topics
    from gateway.people.ros2.wire import Names, WireError
except ImportError as error:
    raise ConfigError("the ROS 2 bridge needs: pip install 'hexapod-gateway[ros2]'") from error

NAME: Final = "ros2"
NODE: Final = "hexapod_gateway"
WITHOUT_HASHES: Final = ("humble",)
WATCH_S: Final = 0.05


def serve(
    connect: Connection,
    *,
    router: str,
    domain: int,
    namespace: str,
    distribution: str,
    drives: bool,
    with_tf: bool,
    geometry: Path | None,
) -> int:
    """Serve until a signal. Returns the exit code. Raises ConfigError, ZenohError."""
    if distribution not in DISTRIBUTIONS:
        raise ConfigError(f"--distro {distribution} is not known; the message types are those of {_all(DISTRIBUTIONS)}")
    try:
        names = Names(domain, namespace, NODE, hashes=distribution not in WITHOUT_HASHES)
    except WireError as error:
        raise ConfigError(f"--ros-namespace: {error}") from error
    shape = load(geometry)
    ended = threading.Event()
    with connect() as client:
        client.state()
        with open_router(router) as session, on_end_signals(ended.set), ExitStack() as at_the_end:
            driving = Driving(client, NAME, shape, _show)
            senders = Senders(session, names, "joint_trajectory")
            at_the_end.callback(senders.close)
            topics = Topics(driving, shape, names, senders, _show)
            node = Node(session, names)
            at_the_end.callback(node.close)
            node.serve("estop", lambda: _estop(client), always=True)
            received = at_the_end.enter_context(subscribed(client.session, CHANNELS))
            reports = Reports(dict(zip(CHANNELS, received, strict=True)), node, shape, driving, topics, with_tf=with_tf)
            with suppress(UnansweredError):  # an older gateway has none
                reports.begin(client.calibration())
            for topic, (kind, take) in topics.table().items():
                node.subscribe(topic, kind, take)
            node.serve("reset", lambda: _reset(client))
            node.serve("drive", driving.drive)
            node.serve("release", driving.release)
            watch = threading.Thread(target=_watch, args=(ended, driving), name="watch the motion", daemon=True)
            watch.start()
            at_the_end.callback(watch.join)
            at_the_end.callback(ended.set)
            at_the_end.callback(driving.close)  # first: what it moves is stopped before anything is waited for
            if drives:
                _drive(driving)
            say(f"{names.full(NODE)} is in ROS 2's graph of {router}, domain {domain}, as {distribution}; Ctrl-C ends")
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


def _estop(client: Client) -> str:
    ack = client.estop()
    return f"emergency stop {ack.estop}: {ack.stop_frames} Stop frames written within {ack.latency_us:.0f} µs"


def _reset(client: Client) -> str:
    ack = client.reset()
    if not ack.accepted:
        raise GatewayError(f"rejected: {ack.reason}: {ack.detail}")
    return "the emergency stop is left; nothing moves until it is started again"


def _show(text: str) -> None:
    hint(visible(text))


def _all(names: tuple[str, ...]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}"
