"""A ROS 2 peer that is not ours: rclpy over FastDDS in a process of its own, which takes its tasks over stdin.

A line is a JSON list, [name, arguments, named arguments]; it is answered by one: {"ok": value} or {"error": words}.
Messages are pickled. It ends as a peer that vanishes does.
Nothing of it leaves this machine, and each run of the tests has a domain of its own.
"""

import json
import os
import pickle
import queue
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.people.ros2.messages import Message
from tests.support.bridged import READY, clean, rejections
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.ros2_messages import plain
from tests.support.waiting import Closing, wait_until

PEER_READY: Final = "the peer is ready"
TRIGGER: Final = "std_srvs/srv/Trigger"
ANSWER_S: Final = 40.0
"""Sitting down takes a while on a busy machine."""
ROOT: Final = Path(__file__).parents[2]
PYTHON: Final = str(ROOT / ".venv/rclpy/bin/python")
"""`make .venv/rclpy` installs it. ROS 2's wheels have each Python beside them start twice, with other libraries."""
needs_rclpy: Final = pytest.mark.skipif(
    not Path(PYTHON).exists(), reason="rclpy is not installed: its wheels are for CPython 3.11 on x86-64"
)
RCLPY_COMMAND: Final = (PYTHON, *COMMAND[1:])
PROFILE: Final = ROOT / "examples" / "ros2" / "this_machine.xml"
NODE: Final = "/hexapod/hexapod_gateway"
COMMANDS: Final = "/hexapod/joint_commands"
DIAGNOSTICS: Final = "/hexapod/diagnostics"
DOMAIN: Final = os.getpid() % 100 + 1
"""The first hundred have ports that no other program is given."""
_MADE_S: Final = 5.0
"""Shared memory is made in a millisecond."""
ENV: Final = {"FASTDDS_DEFAULT_PROFILES_FILE": str(PROFILE), "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}


class RclpyPeer(Closing):
    """The end that a test holds. What it is asked for, the `Actor` in the process does."""

    def __init__(self, domain: int = DOMAIN) -> None:
        _remove_half_made()
        own = {**clean(), "PYTHONPATH": str(ROOT), **ENV}
        self.child = Child([PYTHON, "-m", "tests.support.rclpy_peer", str(domain)], own)
        self.child.wait_for_output(PEER_READY)

    def close(self) -> None:
        self.child.close()

    def __getattr__(self, command: str) -> Callable[..., Any]:
        """Have `Actor` carry out its method of that name."""
        if command.startswith("_"):
            raise AttributeError(command)
        return partial(self._ask, command)

    def next(self, topic: str, condition: Any = lambda _: True) -> Any:
        """Return the next message of a topic for which it holds."""
        end_s = time.monotonic() + ANSWER_S
        while time.monotonic() < end_s:
            message = pickle.loads(bytes.fromhex(self._ask("next", topic)))  # noqa: S301 - our own process's
            if condition(message):
                return message
        raise TimeoutError(f"no such message on {topic}")

    def not_taken(self, topic: str, message: Message, why: str) -> None:
        """Publish until diagnostics contain `why`: a message just after a pause has another reason."""

        def explained(array: Message) -> bool:
            self.publish(topic, message)
            return why in rejections(array)

        self.next(DIAGNOSTICS, explained)

    def _ask(self, command: str, *arguments: object, **named: object) -> Any:
        words = json.dumps([command, [_sent(each) for each in arguments], named])
        answer = json.loads(self.child.ask(words, ANSWER_S))
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return tuple(answer["ok"]) if isinstance(answer["ok"], list) else answer["ok"]


def _sent(argument: Any) -> object:
    """Return a message's type by its name, and a message packed."""
    if isinstance(argument, type):
        return argument.TYPE  # type: ignore[attr-defined]
    return packed(argument) if isinstance(argument, Message) else argument


def packed(message: Any) -> str:
    """Return the message as a line can hold it."""
    return pickle.dumps(message).hex()


class RclpyBridge(Closing):
    """A running bridge by rclpy."""

    def __init__(self, gateway: Gateway, *arguments: str, domain: int = DOMAIN, by: Sequence[str] = ()) -> None:
        """Start it, if `by` is given by this command."""
        _remove_half_made()
        link = ("--connect", gateway.endpoint, "--domain", str(domain))
        self.child = Child([*by, *RCLPY_COMMAND, "ros2", *link, *arguments], clean() | ENV)
        self.child.wait_for_output(READY)

    def close(self) -> None:
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
        self._to_ros: Any = import_module("gateway.people.ros2.node").to_ros
        self._publishers: dict[str, Any] = {}
        self._received: defaultdict[str, queue.SimpleQueue[Any]] = defaultdict(queue.SimpleQueue)
        executor = import_module("rclpy.executors").SingleThreadedExecutor()
        executor.add_node(self._node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def advertise(self, topic: str, kind: str) -> None:
        """Be a publisher from now on."""
        publisher = self._node.create_publisher(_ros_type(kind), topic, 10)
        self._publishers[topic] = publisher
        wait_until(lambda: publisher.get_subscription_count() > 0, "somebody subscribes there", ANSWER_S)

    def publish(self, topic: str, message: str, serialized: bool = False) -> None:
        """Publish a message of an advertised topic; `serialized`: with bytes behind the last field, too."""
        made = self._to_ros(pickle.loads(bytes.fromhex(message)))  # noqa: S301 - our own test's
        self._publishers[topic].publish(self._serialization.serialize_message(made) if serialized else made)

    def publish_empty(self, topic: str) -> None:
        """Publish one std_msgs/Empty."""
        self.advertise(topic, "std_msgs/msg/Empty")
        self._publishers[topic].publish(_ros_type("std_msgs/msg/Empty")())

    def subscribe(self, topic: str, kind: str, latched: bool = False) -> None:
        """Subscribe. `latched`: ask for earlier messages, too."""
        qos = import_module("rclpy.qos")
        profile = qos.QoSProfile(depth=1000)
        if latched:
            profile.durability = qos.DurabilityPolicy.TRANSIENT_LOCAL
        received = self._received[topic]
        self._node.create_subscription(
            _ros_type(kind), topic, lambda found: received.put(packed(plain(found))), profile
        )

    def next(self, topic: str) -> Any:
        return self._received[topic].get(timeout=ANSWER_S / 2)

    def call(self, service: str) -> tuple[bool, str]:
        """Return a Trigger's `success` and `message`."""
        response = self._request(TRIGGER, service)
        return bool(response.success), str(response.message)

    def change_state(self, label: str) -> bool:
        """Do a transition of the bridge's lifecycle, such as `deactivate`. Return whether it succeeded."""
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
        """Return whether it was set, or why not."""
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
        """Return topics and services with their types, as its own discovery finds them."""
        node = self._node
        return dict(node.get_topic_names_and_types()) | dict(node.get_service_names_and_types())


def _remove_half_made() -> None:
    """Remove FastDDS's shared memory whose maker was killed half way: the next opener would wait for ever."""
    for port in Path("/dev/shm").glob("fastdds_port*[0-9]"):  # noqa: S108
        with suppress(OSError):
            if port.stat().st_mtime < time.time() - _MADE_S and port.read_bytes()[:4] == bytes(4):
                port.unlink()


def _ros_type(type_name: str) -> Any:
    package, kind, name = type_name.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


def act(actor: object) -> None:
    """Do what stdin says, until it ends."""
    print(PEER_READY, flush=True)
    for line in sys.stdin:
        name, arguments, named = json.loads(line)
        try:
            answer = {"ok": getattr(actor, name)(*arguments, **named)}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    act(Actor(int(sys.argv[1])))
