"""A ROS 2 peer that is ROS 2: rclpy over FastDDS in a process of its own, told what to do as `ros2_peer`'s.

Nothing of it leaves this machine, and each run of the tests has a domain of its own.
"""

import os
import queue
import sys
import threading
import time
from collections import defaultdict
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.people.ros2.cdr import Message, decode, encode
from gateway.people.ros2.messages import TRIGGER_TYPE, Twist
from tests.support.bridged import READY, clean
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.ros2_peer import ANSWER_S, Peer, act, kind_of

ROOT: Final = Path(__file__).parents[2]
PYTHON: Final = str(ROOT / ".venv/rclpy/bin/python")
"""`make .venv/rclpy` installs it. ROS 2's wheels have each Python beside them start twice, with other libraries."""
needs_rclpy: Final = pytest.mark.skipif(
    not Path(PYTHON).exists(), reason="rclpy is not installed: its wheels are for CPython 3.11 on x86-64"
)
RCLPY_COMMAND: Final = (PYTHON, *COMMAND[1:])
PROFILE: Final = ROOT / "examples" / "ros2" / "this_machine.xml"
NODE: Final = "/hexapod/hexapod_gateway"
DOMAIN: Final = os.getpid() % 100 + 1
"""The first hundred have ports that no other program is given."""
_MADE_S: Final = 5.0
"""Shared memory is made in a millisecond."""
ENV: Final = {"FASTDDS_DEFAULT_PROFILES_FILE": str(PROFILE), "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}


class RclpyPeer(Peer):
    """The end that a test holds."""

    def __init__(self, domain: int = DOMAIN) -> None:
        _remove_half_made()
        self._begin("tests.support.rclpy_peer", str(domain), ENV, PYTHON)

    def advertise(self, topic: str, kind: type[Message], *, best_effort: bool = False) -> None:
        """Be a publisher from now on; `best_effort`: by qos_profile_sensor_data."""
        self._ask("advertise", topic, kind.__name__, best_effort)

    def subscribe(self, topic: str, kind: type[Message], *, latched: bool = False, best_effort: bool = False) -> None:
        """`latched`: and ask for what was published before; `best_effort`: by qos_profile_sensor_data."""
        self._ask("subscribe", topic, kind.__name__, latched, best_effort)

    def publish_bytes(self, topic: str, data: bytes) -> None:
        """These, as they are."""
        self._ask("publish_bytes", topic, data.hex())

    def publish_serialized(self, topic: str, message: Message) -> None:
        """What `serialize_message` returns: bytes behind the last field, too."""
        self._ask("publish", topic, type(message).__name__, encode(message).hex(), True)

    def withdraw(self, topic: str) -> None:
        """Publish there no more."""
        self._ask("withdraw", topic)

    def churn(self, topic: str, count: int) -> None:
        """A node that comes with a publisher, and goes, so many times, ten times a second."""
        self._ask("churn", topic, count)

    def change_state(self, label: str) -> bool:
        """A transition of the bridge's lifecycle, such as `deactivate`: whether it succeeded."""
        return bool(self._ask("change_state", label))

    def state(self) -> str:
        """The state of the bridge's lifecycle, such as `active`."""
        return str(self._ask("state"))

    def parameter(self, name: str) -> Any:
        """A parameter of the bridge."""
        return self._ask("parameter", name)

    def set_parameter(self, name: str, value: bool | float) -> tuple[bool, str]:
        """Whether it was set, or why not."""
        done, why = self._ask("set_parameter", name, value)
        return done, why

    def next_where(self, topic: str, condition: Any) -> Any:
        """The next message of a topic for which it holds."""
        end_s = time.monotonic() + ANSWER_S
        while time.monotonic() < end_s:
            name, data = self.next(topic)
            message = decode(kind_of(name), bytes.fromhex(data))
            if condition(message):
                return message
        raise TimeoutError(f"no such message on {topic}")


class RclpyBridge:
    """A running bridge by rclpy."""

    def __init__(
        self, gateway: Gateway, *arguments: str, domain: int = DOMAIN, env: dict[str, str] | None = None
    ) -> None:
        """With `--via`, an option; `env` is added to the environment."""
        _remove_half_made()
        link = ("--connect", gateway.endpoint, "--domain", str(domain))
        self.child = Child([*RCLPY_COMMAND, "ros2", *link, *arguments], clean() | ENV | (env or {}))
        self.child.wait_for_output(READY, timeout_s=20)

    def __enter__(self) -> "RclpyBridge":
        return self

    def __exit__(self, *_: object) -> None:
        self.child.terminate()
        self.child.wait()
        self.child.close()


class Actor:
    """The end inside the process; each public method is a command."""

    def __init__(self, domain: int) -> None:
        self._rclpy: Any = import_module("rclpy")
        self._rclpy.init(domain_id=domain)
        self._node = self._rclpy.create_node("peer")
        self._serialization = import_module("rclpy.serialization")
        self._publishers: dict[str, Any] = {}
        self._received: defaultdict[str, queue.SimpleQueue[Any]] = defaultdict(queue.SimpleQueue)
        executor = import_module("rclpy.executors").SingleThreadedExecutor()
        executor.add_node(self._node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def advertise(self, topic: str, kind_name: str, best_effort: bool = False) -> None:
        qos = import_module("rclpy.qos").qos_profile_sensor_data if best_effort else 10
        publisher = self._node.create_publisher(_ros_type(kind_of(kind_name).TYPE), topic, qos)
        self._publishers[topic] = publisher
        _wait(lambda: publisher.get_subscription_count() > 0)

    def withdraw(self, topic: str) -> None:
        self._node.destroy_publisher(self._publishers.pop(topic))

    def churn(self, topic: str, count: int) -> None:
        for number in range(count):
            node = self._rclpy.create_node(f"churn_{number}")
            node.create_publisher(_ros_type(Twist.TYPE), topic, 10)
            threading.Event().wait(0.1)
            node.destroy_node()

    def publish(self, topic: str, kind_name: str, cdr: str, serialized: bool = False) -> None:
        """ROS 2 reads our bytes, and writes its own."""
        message = self._serialization.deserialize_message(bytes.fromhex(cdr), _ros_type(kind_of(kind_name).TYPE))
        if serialized:
            message = self._serialization.serialize_message(message)
        self._publishers[topic].publish(message)

    def publish_bytes(self, topic: str, data: str) -> None:
        self._publishers[topic].publish(bytes.fromhex(data))

    def subscribe(self, topic: str, kind_name: str, latched: bool, best_effort: bool = False) -> None:
        qos = import_module("rclpy.qos")
        profile = qos.qos_profile_sensor_data if best_effort else qos.QoSProfile(depth=1000)
        if latched:
            profile.durability = qos.DurabilityPolicy.TRANSIENT_LOCAL
        received = self._received[topic]

        def take(message: Any) -> None:
            received.put((kind_name, self._serialization.serialize_message(message).hex()))

        self._node.create_subscription(_ros_type(kind_of(kind_name).TYPE), topic, take, profile)

    def next(self, topic: str) -> Any:
        return self._received[topic].get(timeout=ANSWER_S / 2)

    def call(self, service: str) -> tuple[bool, str]:
        response = self._request(TRIGGER_TYPE, service)
        return bool(response.success), str(response.message)

    def change_state(self, label: str) -> bool:
        transition = import_module("lifecycle_msgs.msg").Transition(label=label)
        return bool(
            self._request("lifecycle_msgs/srv/ChangeState", f"{NODE}/change_state", transition=transition).success
        )

    def state(self) -> str:
        return str(self._request("lifecycle_msgs/srv/GetState", f"{NODE}/get_state").current_state.label)

    def parameter(self, name: str) -> Any:
        (found,) = self._request("rcl_interfaces/srv/GetParameters", f"{NODE}/get_parameters", names=[name]).values
        return import_module("rclpy.parameter").parameter_value_to_python(found)

    def set_parameter(self, name: str, value: bool | float) -> tuple[bool, str]:
        wanted = import_module("rclpy.parameter").Parameter(name, value=value).to_parameter_msg()
        kind, service = "rcl_interfaces/srv/SetParameters", f"{NODE}/set_parameters"
        (result,) = self._request(kind, service, parameters=[wanted]).results
        return bool(result.successful), str(result.reason)

    def _request(self, type_name: str, service: str, **fields: Any) -> Any:
        found = _ros_type(type_name)
        client = self._node.create_client(found, service)
        if not client.wait_for_service(ANSWER_S / 2):
            raise TimeoutError(f"nobody serves {service}")
        response = client.call(found.Request(**fields), ANSWER_S)
        self._node.destroy_client(client)
        return response

    def graph(self) -> dict[str, list[str]]:
        node = self._node
        return dict(node.get_topic_names_and_types()) | dict(node.get_service_names_and_types())


def _remove_half_made() -> None:
    """Shared memory of FastDDS whose maker was killed before it was ready: the next to open it waits for ever."""
    for port in Path("/dev/shm").glob("fastdds_port*[0-9]"):  # noqa: S108
        with suppress(OSError):
            if port.stat().st_mtime < time.time() - _MADE_S and port.read_bytes()[:4] == bytes(4):
                port.unlink()


def _wait(condition: Any) -> None:
    """DDS reports no event of discovery to Python."""
    ended = threading.Event()
    for _ in range(int(ANSWER_S / 0.02)):
        if condition():
            return
        ended.wait(0.02)
    raise TimeoutError("nobody subscribes there")


def _ros_type(type_name: str) -> Any:
    package, kind, name = type_name.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


if __name__ == "__main__":
    act(Actor(int(sys.argv[1])))
