"""What the bridge needs of a ROS 2 graph: one node's publishers, subscriptions and services. Messages are bytes (CDR).

Two implementations: `zenoh_graph` speaks rmw_zenoh's wire itself, `rclpy_graph` is a node of an installed ROS 2.
"""

import logging
from collections.abc import Callable, Iterable, Set
from typing import Any, Final, NamedTuple, Protocol

from gateway.errors import GatewayError
from gateway.people.bridge.parameters import Parameters
from gateway.people.client.blocking import Client
from gateway.people.ros2.cdr import Message
from gateway.people.ros2.messages import TriggerResponse

JOIN_S: Final = 1.0

_log: Final = logging.getLogger(__name__)


class Arrived(NamedTuple):
    """One message, as it was received."""

    data: bytes
    sender: bytes
    """The publisher's GID, 16 bytes; empty where the graph does not report it."""
    time_ns: int
    """When it was sent: since 1970, by the sender's clock."""


Take = Callable[[type[Message], Arrived], None]
Reply = Callable[[Message], None]
"""Answers one request, once, now or later, on any thread."""
Respond = Callable[[Arrived, Reply], None]
Present = Callable[[], Set[bytes]]
"""Returns the GIDs of those who publish on a topic now."""


class Publisher(Protocol):
    """Publishes on one topic; for one thread."""

    def publish(self, message: Message) -> None:
        """Fire and forget: without a connection the message is lost. Raises CdrError."""


class Graph(Protocol):
    """One node, until `close`. Each subscription and service has a thread, so a slow one delays no other."""

    where: str
    """Which graph this is, for people."""

    def check_closed(self) -> None:
        """Raises ConfigError where others on the network reach the node without certificates, or may reach it."""

    def check_apart(self, client: Client) -> None:
        """Raises ConfigError where ROS peers reach the gateway itself."""

    def parameters(self, given: Parameters) -> Parameters:
        """What holds: `given`, and what the graph's own parameters have in place of it. Raises ConfigError."""

    def publisher(self, topic: str, kind: type[Message], *, latched: bool = False, always: bool = False) -> Publisher:
        """Announce a topic; with `latched`, later subscribers receive the last message.

        `always`: also while the node is not active, and so is what is latched.
        """

    def manage(self, activate: Callable[[], None], deactivate: Callable[[str], None]) -> None:
        """Have the node's lifecycle decide from now on; where the graph has none, it is active until `close`.

        `deactivate` takes the reason, and may wait for the robot to sit down.
        """

    def subscribe(
        self, topic: str, kinds: tuple[type[Message], ...], most_bytes: int, take: Take, reject: Callable[[str], None]
    ) -> None:
        """Call `take` with the newest message, or `reject` with the reason why it cannot be read.

        The graph shows the first of `kinds`; the others are taken where the graph lets one topic have several types.
        """

    def serve(self, service: str, call: Callable[[], str], *, always: bool = False) -> None:
        """Serve a std_srvs/Trigger. `call` returns what it did, or raises GatewayError.

        `always`: a message on a topic of that name calls it, too, and so does a malformed request where it arrives.
        """

    def respond(self, service: str, kind: tuple[str, str], most_bytes: int, respond: Respond) -> None:
        """Serve a service of any type; `kind` is its type and hash. A longer request than `most_bytes` has no answer.

        Raises ConfigError where this graph does not have the type.
        """

    def senders(self, topic: str) -> Present:
        """Follow who publishes on a topic, from now on."""

    def callers(self, service: str) -> Present:
        """Follow who may call a service, from now on; where the graph does not report GIDs, how many."""

    def close(self) -> None:
        """Leave the graph and wait for the threads; a second call does nothing."""


def presence(sender: bytes, present: Present) -> Callable[[], bool]:
    """Returns whether this sender is still there; of one whose GID is not shown, whether all others are."""
    before = frozenset(present())
    if sender in before:
        return lambda: sender in present()
    return lambda: bool(before) and before <= present()


def too_long(size: int, most: int) -> str:
    """Why a message of `size` bytes is rejected."""
    return f"it has {size} bytes, and at most {most} are taken"


def attempt(call: Callable[[], str]) -> TriggerResponse:
    """The response of a service that has done `call`."""
    try:
        return TriggerResponse(True, call())
    except GatewayError as error:
        return TriggerResponse(False, str(error).replace("\0", "�"))


def read_each(received: Iterable[Any], take: Callable[[Any], object]) -> None:
    """Until `received` ends. An error in one message is logged and does not end the topic, least of all a Stop's."""
    for each in received:
        try:
            take(each)
        except Exception:
            _log.exception("a message could not be handled")
