"""What the bridge needs of ROS 2's graph, without ROS 2: what has arrived, and whether its sender is still there."""

import logging
from collections.abc import Callable, Iterable, Set
from typing import Any, Final, NamedTuple

from gateway.errors import GatewayError

_log: Final = logging.getLogger(__name__)


class Arrived(NamedTuple):
    """When and by whom a message was sent."""

    sender: bytes
    """The publisher's GID, 16 bytes; empty if ROS 2 does not report it."""
    time_ns: int
    """When it was sent: since 1970, by the sender's clock."""


Present = Callable[[], Set[bytes]]
"""Returns the GIDs of those who publish on a topic now."""


def presence(sender: bytes, present: Present) -> Callable[[], bool]:
    """Returns whether this sender is still there; of one whose GID is not shown, whether all others are."""
    before = frozenset(present())
    if sender in before:
        return lambda: sender in present()
    return lambda: bool(before) and before <= present()


def too_long(size: int, most: int) -> str:
    """Why a message of `size` bytes is rejected."""
    return f"it has {size} bytes, and at most {most} are taken"


def attempt(call: Callable[[], str]) -> tuple[bool, str]:
    """Success and message of a service that has done `call`."""
    try:
        return True, call()
    except GatewayError as error:
        return False, str(error).replace("\0", "�")


def read_each(received: Iterable[Any], take: Callable[[Any], object]) -> None:
    """Until `received` ends. An error in one message is logged and does not end the topic, least of all a Stop's."""
    for each in received:
        try:
            take(each)
        except Exception:
            _log.exception("a message could not be handled")
