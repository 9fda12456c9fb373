"""A ROS 2 graph by an installed ROS 2: a node of rclpy, over whatever RMW is set (FastDDS, CycloneDDS, …).

Messages stay bytes: rclpy passes them on as they are serialised. A thread waits for each subscription and each service.
So a flood on one topic delays no other, and a service that waits delays no emergency stop. An executor of rclpy would
call one after the other, and look through all that its node has for each message.
"""

import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Set
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions

from gateway.endpoints import is_local
from gateway.errors import ConfigError
from gateway.people.bridge.graph import (
    JOIN_S,
    Arrived,
    Present,
    Publisher,
    Reply,
    Respond,
    Take,
    attempt,
    read_each,
    too_long,
)
from gateway.people.bridge.managed_node import ManagedNode
from gateway.people.bridge.parameters import Parameters
from gateway.people.client.blocking import Client
from gateway.people.ros2.cdr import Message, encode
from gateway.people.ros2.messages import TRIGGER_TYPE, JointState, Twist, TwistStamped
from gateway.people.ros2.wire import Names

_GID_BYTES: Final = 16
"""Of the GID's bytes that have a meaning; before Jazzy there are 24."""
_REQUESTS: Final = 16
"""Of one service that wait; of more, the oldest have no answer. An emergency stop is engaged all the same."""
_ANY_MESSAGE: Final = "std_msgs/msg/Empty"
_STREAMS: Final = (JointState, Twist, TwistStamped)
"""Sensor data: received best effort, which matches every publisher, and repeats nothing that a link has lost."""

_log: Final = logging.getLogger(__name__)


class RclpyGraph:
    """See Graph."""

    def __init__(self, names: Names, ros_args: list[str]) -> None:
        """`ros_args` are ROS's own, such as `--ros-args -r cmd_vel:=/cmd_vel_out`. Raises ConfigError."""
        self._context = rclpy.Context()
        self._closed = threading.Event()
        self._guards: list[GuardCondition] = []
        self._own_threads = _OwnThreads()
        self._threads: list[threading.Thread] = []
        try:
            rclpy.init(
                args=["hexapod-gateway", *ros_args],
                context=self._context,
                domain_id=names.domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            rmw = rclpy.get_rmw_implementation_identifier()
            if "zenoh" in rmw:
                raise ConfigError(f"with {rmw}, take --via zenoh: it looks who reaches ROS 2's router")
            self._node = ManagedNode(names, self._context)
        except RuntimeError as error:  # an argument that rcl does not know, or no such RMW
            raise ConfigError(f"ROS 2 does not start: {str(error).partition(', at ')[0]}") from error
        self.where = rmw

    def check_closed(self) -> None:
        """See Graph: which addresses the sockets of this process have, and so whether DDS leaves this machine.

        Neither ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST nor a firewall counts: with the former, FastDDS's sockets are
        still open to who knows their port.
        """
        found = sorted({address for address in _own_addresses() if not is_local(f"udp/{address}:1")})
        if found:
            raise ConfigError(
                f"ROS 2's graph is open to the network ({self.where} has sockets on {', '.join(found)}), and all who "
                "reach it could drive the robot: keep it on this machine by "
                "FASTDDS_DEFAULT_PROFILES_FILE=examples/ros2/this_machine.xml (docs/ros2.md), or accept that with "
                "--open-graph"
            )

    def check_apart(self, client: Client) -> None:
        """See Graph. The gateway speaks no DDS."""

    def parameters(self, given: Parameters) -> Parameters:
        """See Graph."""
        return self._node.declare(given)

    def manage(self, activate: Callable[[], None], deactivate: Callable[[str], None]) -> None:
        """See Graph."""
        self._node.manage(activate, deactivate)

    def publisher(self, topic: str, kind: type[Message], *, latched: bool = False, always: bool = False) -> Publisher:
        """See Graph. Reliable, as well for sensor data: so each subscriber matches, SensorData's too."""
        node = self._node
        create = node.create_publisher if latched or always else node.create_lifecycle_publisher
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL) if latched else QoSProfile(depth=10)
        quiet = PublisherEventCallbacks(use_default_callbacks=False)  # of another QoS, the subscriber's own node warns
        return _RclpyPublisher(create(_same_type(kind), topic, qos, event_callbacks=quiet))

    def subscribe(
        self, topic: str, kinds: tuple[type[Message], ...], most_bytes: int, take: Take, reject: Callable[[str], None]
    ) -> None:
        """See Graph. DDS lets a topic have one type: the first."""

        def received(message: tuple[bytes, dict[str, Any]]) -> None:
            data, info = message
            if len(data) > most_bytes:
                reject(too_long(len(data), most_bytes))
            else:
                take(kinds[0], Arrived(data, _gid(info), info["source_timestamp"]))

        self._listen(topic, kinds[0].TYPE, received, is_stream=kinds[0] in _STREAMS)

    def serve(self, service: str, call: Callable[[], str], *, always: bool = False) -> None:
        """See Graph. `always`: a message on a topic of that name is a std_msgs/Empty."""
        self._requests(service, TRIGGER_TYPE, lambda _, reply: reply(attempt(call)))
        if always:
            self._listen(service, _ANY_MESSAGE, lambda _: attempt(call))

    def respond(self, service: str, kind: tuple[str, str], most_bytes: int, respond: Respond) -> None:
        """See Graph."""

        def take(arrived: Arrived, reply: Reply) -> None:
            if len(arrived.data) > most_bytes:
                _log.warning("%s: %s", service, too_long(len(arrived.data), most_bytes))
            else:
                respond(arrived, reply)

        self._requests(service, kind[0], take)

    def senders(self, topic: str) -> Present:
        """See Graph."""
        return self._present(
            lambda: (bytes(each.endpoint_gid[:_GID_BYTES]) for each in self._node.get_publishers_info_by_topic(topic))
        )

    def callers(self, service: str) -> Present:
        """See Graph. rclpy reports no GIDs of clients."""
        return self._present(
            lambda: (
                b"%d" % number for number in range(self._node.count_clients(self._node.resolve_service_name(service)))
            )
        )

    def _present(self, find: Callable[[], Iterable[bytes]]) -> Present:
        def present() -> Set[bytes]:
            try:
                return frozenset(find())
            except RuntimeError:  # the context is shut down: then nobody is seen
                return frozenset()

        return present

    def close(self) -> None:
        """See Graph."""
        if self._closed.is_set():
            return
        self._closed.set()
        for guard in self._guards:
            guard.trigger()
        for thread in self._threads:
            thread.join(JOIN_S)
        self._node.close()
        self._context.try_shutdown()

    def _requests(self, service: str, type_name: str, take: Respond) -> None:
        """The executor's own services get a request's answer at once; this one's may come later, from any thread."""
        found = _ros_type(type_name)
        made = self._node.create_service(
            found, service, _nothing, qos_profile=QoSProfile(depth=_REQUESTS), callback_group=self._own_threads
        )

        def reply_to(header: Any) -> Reply:
            def reply(response: Message) -> None:
                with suppress(RuntimeError):
                    made.send_response(deserialize_message(encode(response), found.Response), header)

            return reply

        def receive() -> None:
            request, header = made.handle.service_take_request(found.Request)
            if request is not None:
                take(Arrived(serialize_message(request), b"", time.time_ns()), reply_to(header))

        self._start(f"serve {service}", made.handle, "service", receive)

    def _listen(self, topic: str, type_name: str, take: Callable[[Any], object], *, is_stream: bool = False) -> None:
        found = _ros_type(type_name)
        made = self._node.create_subscription(
            found,
            topic,
            _nothing,
            QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT if is_stream else ReliabilityPolicy.RELIABLE),
            raw=True,
            callback_group=self._own_threads,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

        def receive() -> None:
            message = made.handle.take_message(found, True)
            if message is not None:
                take(message)

        self._start(f"receive {topic}", made.handle, "subscription", receive)

    def _start(self, name: str, handle: Any, kind: str, receive: Callable[[], None]) -> None:
        """Wait for this entity's messages on a thread, until `close`."""
        ends = GuardCondition(None, None, self._context)
        self._guards.append(ends)
        count = 1 if kind == "subscription" else 0
        waiting = _rclpy.WaitSet(count, 1, 0, 0, 1 - count, 0, self._context.handle)

        def ready() -> Iterator[None]:
            with handle:
                while not self._closed.is_set():
                    waiting.clear_entities()
                    getattr(waiting, f"add_{kind}")(handle)
                    waiting.add_guard_condition(ends.handle)
                    waiting.wait(-1)
                    yield

        thread = threading.Thread(target=read_each, args=(ready(), lambda _: receive()), name=name, daemon=True)
        self._threads.append(thread)
        thread.start()


class _RclpyPublisher:
    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def publish(self, message: Message) -> None:
        data = encode(message)
        with suppress(RuntimeError):
            self._publisher.publish(data)


class _OwnThreads(CallbackGroup):  # type: ignore[misc]
    """What threads of ours wait for, and no executor."""

    def can_execute(self, entity: Any) -> bool:
        """See CallbackGroup."""
        del entity
        return False


def _nothing(*_: object) -> None:
    """The callback that no executor calls."""


def _ros_type(type_name: str) -> Any:
    """`std_msgs/msg/String` → rclpy's class. Raises ConfigError where its package is not installed."""
    package, kind, name = type_name.split("/")
    action, _, part = name.partition("_")
    try:
        found = getattr(import_module(f"{package}.{kind}"), action)
        if not part:
            return found
        if part in ("Goal", "Result", "Feedback"):
            return getattr(found, part)
        return getattr(found.Impl, part if part.endswith("Message") else f"{part}Service")
    except ImportError as error:
        raise ConfigError(f"this ROS 2 has no {package}: {error}") from error


def _same_type(kind: type[Message]) -> Any:
    """rclpy's class of this type. Raises ConfigError where its fields are others: our bytes would be misread."""
    found = _ros_type(kind.TYPE)
    if list(found.get_fields_and_field_types()) != [field.name for field in kind.FIELDS]:
        raise ConfigError(f"this ROS 2 has another {kind.TYPE} (of a newer release?)")
    for field in kind.FIELDS:
        if not isinstance(field.element, str):
            _same_type(field.element)
    return found


def _gid(info: dict[str, Any]) -> bytes:
    """The sender's; rclpy before Kilted does not report it."""
    found = info.get("publisher_gid")
    return bytes(found["data"][:_GID_BYTES]) if found else b""


def _own_addresses() -> Iterator[str]:
    """The addresses of this process's sockets. Raises ConfigError where the system does not show its sockets."""
    try:
        names = os.listdir("/proc/self/fd")
    except OSError as error:
        raise ConfigError(f"this system does not show which sockets are open: {error}") from error
    for name in names:
        with suppress(OSError):  # closed meanwhile
            if Path("/proc/self/fd", name).readlink().name.startswith("socket:"):
                with socket.socket(fileno=os.dup(int(name))) as found:
                    if found.family in (socket.AF_INET, socket.AF_INET6):
                        host, port, *_ = found.getsockname()
                        if port:  # else it is bound to none, and nothing reaches it
                            yield f"[{host}]" if found.family == socket.AF_INET6 else host
