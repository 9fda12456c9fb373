"""The bridge's node in a ROS 2 graph: by rclpy, over whatever RMW is set (FastDDS, CycloneDDS, Zenoh, …).

A thread waits for each subscription and each service. So a flood on one topic delays no other, and a service that waits
delays no emergency stop. rclpy's MultiThreadedExecutor with a callback group for each does this, too, in 40 lines less,
but at 45 joint commands a second the process then used 15 % of a core, not 9 %. Only the lifecycle and the parameters
have an executor, since a transition may wait until the robot sits.
"""

import logging
import os
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import rclpy
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidNamespaceException, ParameterException
from rclpy.executors import MultiThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from gateway.errors import ConfigError, GatewayError
from gateway.people.ros2.messages import Message
from gateway.people.ros2.parameters import DESCRIPTIONS, Parameters
from gateway.people.ros2.received import read_each
from gateway.zenoh.endpoints import is_local

NAME: Final = "hexapod_gateway"
SIMULATED: Final = "use_sim_time is set, and the time of a robot is real"

_JOIN_S: Final = 1.0
_SPIN_S: Final = 0.5
_THREADS: Final = 2
"""Threads of the executor: a transition that waits keeps one."""
_GID_BYTES: Final = 16
"""Bytes of a GID that count; before Jazzy there are 24."""
_REQUESTS: Final = 16
"""Most pending requests of one service. With more, the oldest get no answer; an emergency stop is engaged anyway."""
_STREAMS: Final = ("sensor_msgs/msg/JointState", "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""Sensor data: received best effort, which matches every publisher, and repeats nothing that a link has lost."""
_INACTIVE: Final = "the node is not active: its lifecycle is managed, and nobody has activated it"

_log: Final = logging.getLogger(__name__)


class Node(LifecycleNode):  # type: ignore[misc]
    """One node, until `close`. Active once `manage` was called, unless the parameter `autostart` is false."""

    def __init__(self, domain: int, namespace: str, ros_args: list[str]) -> None:
        """`ros_args` are ROS's own, such as `--ros-args -r cmd_vel:=/cmd_vel_out`. Raises ConfigError."""
        self._ros = rclpy.Context()
        self._closed = threading.Event()
        self._guards: list[GuardCondition] = []
        self._own_threads = _OwnThreads()
        self._threads: list[threading.Thread] = []
        self._begin: Callable[[], None]
        self._end: Callable[[str], None]
        if not os.access(os.environ.get("HOME", ""), os.W_OK):  # for a user without a home ROS 2 does not start
            os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp(prefix="hexapod-ros2-"))
        try:
            rclpy.init(
                args=["hexapod-gateway", *ros_args],
                context=self._ros,
                domain_id=domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            super().__init__(NAME, namespace=namespace, context=self._ros, enable_rosout=False)
        except InvalidNamespaceException as error:
            raise ConfigError(f"--ros-namespace: {namespace!r} is no ROS namespace, such as /hexapod") from error
        except RuntimeError as error:  # an argument that rcl does not know, or no such RMW
            raise ConfigError(f"ROS 2 does not start: {str(error).partition(', at ')[0]}") from error
        self.rmw = rclpy.get_rmw_implementation_identifier()
        self._executor = MultiThreadedExecutor(_THREADS, context=self._ros)
        self._spinning = threading.Thread(target=self._spin, name="ROS 2", daemon=True)

    def parameters(self, defaults: Parameters) -> Parameters:
        """Return the node's parameters, read at the start; else their `defaults`. Raises ConfigError."""
        found = {name: self._declared(name, value, DESCRIPTIONS[name]) for name, value in asdict(defaults).items()}
        return Parameters(**found)

    # ---- topics and services

    def publisher(
        self, topic: str, kind: type[Message], *, latched: bool = False, always: bool = False, optional: bool = False
    ) -> Callable[[Message], None]:
        """Announce a topic, and return what publishes on it. `latched`: later subscribers receive the last message.

        `always`: also while the node is not active, and so is what is latched. Reliable, so each subscriber matches,
        SensorData's too. Raises ConfigError if this ROS 2 lacks the type; if `optional`, nothing is published then.
        """
        try:
            found = ros_type(kind.TYPE)
        except ConfigError:
            if optional:
                return lambda _: None
            raise
        create = self.create_publisher if latched or always else self.create_lifecycle_publisher
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL) if latched else QoSProfile(depth=10)
        quiet = PublisherEventCallbacks(use_default_callbacks=False)  # of another QoS, the subscriber's own node warns
        made = create(found, topic, qos, event_callbacks=quiet)

        def publish(message: Message) -> None:
            with suppress(RuntimeError):  # the context is shut down
                made.publish(to_ros(message))

        return publish

    def subscribe(
        self,
        topic: str,
        kind: str,
        most_bytes: int,
        take: Callable[[Any, bytes, int], None],
        reject: Callable[[str], None],
    ) -> None:
        """Call `take` with the newest message of this type, its sender's GID (16 bytes; empty: unknown) and its time.

        The time is in ns since 1970, by the sender's clock. Or call `reject` with the reason why it cannot be read.
        """
        found = ros_type(kind)

        def received(message: tuple[bytes, dict[str, Any]]) -> None:
            data, info = message
            if len(data) > most_bytes:
                return reject(f"it has {len(data)} bytes, and at most {most_bytes} are taken")
            try:
                read = deserialize_message(data, found)
            except RuntimeError as error:
                return reject(f"it cannot be read: {error}")
            sender = info.get("publisher_gid")  # rclpy before Kilted does not report it
            gid = bytes(sender["data"][:_GID_BYTES]) if sender else b""
            return take(read, gid, info["source_timestamp"])

        self._listen(topic, found, received, is_stream=kind in _STREAMS)

    def serve(self, service: str, call: Callable[[], str], *, always: bool = False) -> None:
        """Serve a std_srvs/Trigger. `call` returns what it did, or raises GatewayError.

        `always`: a std_msgs/Empty on a topic of that name calls it, too.
        """
        qos = QoSProfile(depth=_REQUESTS)
        made = self.create_service(Trigger, service, lambda *_: None, qos_profile=qos, callback_group=self._own_threads)

        def receive() -> None:
            request, header = made.handle.service_take_request(Trigger.Request)
            if request is not None:
                success, message = _attempt(call)
                with suppress(RuntimeError):
                    made.send_response(Trigger.Response(success=success, message=message), header)

        self._start(f"serve {service}", made.handle, "service", receive)
        if always:
            self._listen(service, Empty, lambda _: _attempt(call))

    def _listen(self, topic: str, found: Any, take: Callable[[Any], object], *, is_stream: bool = False) -> None:
        reliability = ReliabilityPolicy.BEST_EFFORT if is_stream else ReliabilityPolicy.RELIABLE
        qos = QoSProfile(depth=1, reliability=reliability)
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        made = self.create_subscription(
            found, topic, lambda *_: None, qos, raw=True, callback_group=self._own_threads, event_callbacks=quiet
        )

        def receive() -> None:
            message = made.handle.take_message(found, True)
            if message is not None:
                take(message)

        self._start(f"receive {topic}", made.handle, "subscription", receive)

    def _start(self, name: str, handle: Any, kind: str, receive: Callable[[], None]) -> None:
        """Wait for this entity's messages on a thread, until `close`."""
        ends = GuardCondition(None, None, self._ros)
        self._guards.append(ends)
        count = 1 if kind == "subscription" else 0
        waiting = _rclpy.WaitSet(count, 1, 0, 0, 1 - count, 0, self._ros.handle)

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

    # ---- its lifecycle

    def manage(self, activate: Callable[[], None], deactivate: Callable[[str], None]) -> None:
        """Have the lifecycle decide from now on. `deactivate` takes the reason, and may wait for the robot to sit down.

        Raises ConfigError.
        """
        self._begin, self._end = activate, deactivate
        deactivate(_INACTIVE)
        self.add_on_set_parameters_callback(_keep_time_real)
        if self._declared("autostart", True, "whether it configures and activates itself at its start"):
            self.trigger_configure()
            self.trigger_activate()
        self._executor.add_node(self)
        self._spinning.start()

    def close(self) -> None:
        """Leave the graph and wait for the threads; a second call does nothing."""
        if self._closed.is_set():
            return
        self._closed.set()
        for guard in self._guards:
            guard.trigger()
        for thread in self._threads:
            thread.join(_JOIN_S)
        self._executor.wake()
        if self._spinning.is_alive():
            self._spinning.join(_JOIN_S)
        self._executor.shutdown(_JOIN_S)
        self.destroy_node()
        self._ros.try_shutdown()

    def _spin(self) -> None:
        while not self._closed.is_set():
            try:
                self._executor.spin_once(_SPIN_S)
            except Exception:  # of one request: others are answered
                _log.exception("a request to the node could not be answered")

    def _declared(self, name: str, value: Any, description: str) -> Any:
        described = ParameterDescriptor(description=description, read_only=True)
        try:
            return self.declare_parameter(name, value, described).value
        except ParameterException as error:
            raise ConfigError(f"parameter {name}: {error}") from error

    # each transition takes the state before it

    def on_activate(self, state: Any) -> Any:
        """Allow `drive` from now on; fail if use_sim_time is set."""
        if self.get_parameter("use_sim_time").value:
            self._end(SIMULATED)
            self.get_logger().error(SIMULATED)
            return TransitionCallbackReturn.FAILURE
        self._begin()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> Any:
        """Sit down, stop the servos, and reject `drive`."""
        self._end(_INACTIVE)
        return super().on_deactivate(state)

    def on_shutdown(self, state: Any) -> Any:
        """Deactivate permanently; the emergency stop is still served."""
        self._end("the node was shut down")
        return super().on_shutdown(state)

    def on_error(self, state: Any) -> Any:
        """Deactivate until the node is configured and activated again."""
        self._end(_INACTIVE)
        return super().on_error(state)


def ros_type(type_name: str) -> Any:
    """`std_msgs/msg/String` → rclpy's class. Raises ConfigError if its package is not installed."""
    package, kind, name = type_name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), name)
    except ImportError as error:
        raise ConfigError(f"this ROS 2 has no {package}: {error}") from error


def to_ros(value: Any) -> Any:
    """Return a message or a field's value in rclpy's types. Fields that are not set have rclpy's defaults.

    Raises AssertionError as rclpy does.
    """
    if not isinstance(value, Message):
        return list(map(to_ros, value)) if isinstance(value, tuple) else value
    made = ros_type(value.TYPE)()
    for name, each in vars(value).items():
        setattr(made, name, bytes((each,)) if isinstance(getattr(made, name), bytes) else to_ros(each))
    return made


def _attempt(call: Callable[[], str]) -> tuple[bool, str]:
    """Do `call`. Return success and message of the service."""
    try:
        return True, call()
    except GatewayError as error:
        return False, str(error).replace("\0", "\ufffd")


class _OwnThreads(CallbackGroup):  # type: ignore[misc]
    """Entities that our own threads wait for, instead of an executor."""

    def can_execute(self, entity: Any) -> bool:
        del entity
        return False


def _keep_time_real(parameters: list[Any]) -> Any:
    simulated = any(each.name == "use_sim_time" and each.value for each in parameters)
    return SetParametersResult(successful=not simulated, reason=SIMULATED if simulated else "")


def open_on() -> Iterator[str]:
    """Yield the addresses beyond this machine to which sockets of this process are bound: others may reach them.

    The any address, if the system does not show them. ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST does not count: FastDDS's
    sockets are still open on all addresses.
    """
    try:
        names = os.listdir("/proc/self/fd")
    except OSError:
        yield "0.0.0.0"  # noqa: S104
        return
    for name in names:
        with suppress(OSError):  # closed meanwhile
            if Path("/proc/self/fd", name).readlink().name.startswith("socket:"):
                with socket.socket(fileno=os.dup(int(name))) as found:
                    if found.family in (socket.AF_INET, socket.AF_INET6):
                        host, port, *_ = found.getsockname()
                        address = f"[{host}]" if found.family == socket.AF_INET6 else host
                        if port and not is_local(f"udp/{address}:1"):  # without a port nothing reaches it
                            yield address
