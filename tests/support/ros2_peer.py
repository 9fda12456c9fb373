"""A ROS 2 peer that is not ours: `zenoh-ros2-sdk` in a process of its own, told what to do over stdin.

A JSON list a line, [name, arguments …], a JSON value back. The SDK keeps one session for its whole process, so each
peer is a process; its end is that of a peer that vanishes.
"""

import json
import os
import queue
import sys
from collections import defaultdict
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import zenoh_ros2_sdk as sdk
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

from gateway.people.ros2 import messages
from gateway.people.ros2.cdr import Message, definition, encode
from gateway.people.ros2.messages import TRIGGER_HASH, TRIGGER_TYPE, TriggerRequest, TriggerResponse
from tests.support.child import Child

ANSWER_S: Final = 40.0
"""Sitting down takes a while on a busy machine."""
READY: Final = "the peer is ready"


class Peer:
    """The end that a test holds."""

    def __init__(self, endpoint: str) -> None:
        self._begin("tests.support.ros2_peer", endpoint.rpartition(":")[2], {"GIT_PYTHON_REFRESH": "quiet"})

    def _begin(self, module: str, argument: str, env: dict[str, str], python: str = sys.executable) -> None:
        env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), **env}
        self.child = Child([python, "-m", module, argument], env)
        self.child.wait_for_output(READY, timeout_s=30)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.close()

    def advertise(self, topic: str, kind: type[Message]) -> None:
        """Be a publisher from now on."""
        self._ask("advertise", topic, kind.__name__)

    def publish(self, topic: str, message: Message) -> None:
        """One message of a topic that is advertised."""
        self._ask("publish", topic, type(message).__name__, encode(message).hex())

    def subscribe(self, topic: str, kind: type[Message], *, latched: bool = False) -> None:
        """`latched`: and ask for what was published before."""
        self._ask("subscribe", topic, kind.__name__, latched)

    def next(self, topic: str) -> Any:
        """The next message of a topic, as a dict."""
        return self._ask("next", topic)

    def call(self, service: str) -> tuple[bool, str]:
        """A Trigger's `success` and `message`."""
        success, message = self._ask("call", service)
        return success, message

    def graph(self) -> Any:
        """Topics and services with their types, as its own discovery finds them."""
        return self._ask("graph")

    def _ask(self, *words: object) -> Any:
        answer = json.loads(self.child.ask(json.dumps(words), ANSWER_S))
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return answer["ok"]


class Actor:
    """The end inside the process; each public method is a command."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._publishers: dict[str, Any] = {}
        self._kept: list[Any] = []
        self._received: defaultdict[str, queue.SimpleQueue[Any]] = defaultdict(queue.SimpleQueue)
        self._store = sdk.ZenohSession.get_instance("127.0.0.1", port).store

    def advertise(self, topic: str, kind_name: str) -> None:
        kind = kind_of(kind_name)
        self._publishers[topic] = sdk.ROS2Publisher(
            topic, kind.TYPE, definition(kind), router_port=self._port, type_hash=kind.HASH
        )

    def publish(self, topic: str, kind_name: str, cdr: str) -> None:
        kind = kind_of(kind_name)
        message = self._store.deserialize_cdr(bytes.fromhex(cdr), kind.TYPE)
        self._publishers[topic].publish(**{field.name: getattr(message, field.name) for field in kind.FIELDS})

    def subscribe(self, topic: str, kind_name: str, latched: bool) -> None:
        kind = kind_of(kind_name)
        qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1) if latched else None
        received = self._received[topic]
        self._kept.append(
            sdk.ROS2Subscriber(
                topic,
                kind.TYPE,
                lambda message: received.put(asdict(message)),
                definition(kind),
                router_port=self._port,
                type_hash=kind.HASH,
                qos=qos,
            )
        )

    def next(self, topic: str) -> Any:
        return self._received[topic].get(timeout=ANSWER_S / 2)

    def call(self, service: str) -> tuple[bool, str]:
        client = sdk.ROS2ServiceClient(
            service,
            TRIGGER_TYPE,
            definition(TriggerRequest) or "\n",
            definition(TriggerResponse),
            router_port=self._port,
            type_hash=TRIGGER_HASH,
            timeout=ANSWER_S / 2,
        )
        try:
            response = client.call()
        finally:
            client.close()
        if response is None:
            raise TimeoutError(f"{service} did not answer")
        return bool(response.success), str(response.message)

    def graph(self) -> dict[str, list[str]]:
        found = sdk.get_topic_names_and_types(0, router_port=self._port)
        return dict(found) | dict(sdk.get_service_names_and_types(0, router_port=self._port))


def kind_of(name: str) -> type[Message]:
    found: type[Message] = getattr(messages, name)
    return found


def act(actor: object) -> None:
    """Do what stdin says, until it ends."""
    print(READY, flush=True)
    for line in sys.stdin:
        name, *arguments = json.loads(line)
        try:
            answer = {"ok": getattr(actor, name)(*arguments)}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer, default=np.ndarray.tolist), flush=True)


if __name__ == "__main__":
    act(Actor(int(sys.argv[1])))
