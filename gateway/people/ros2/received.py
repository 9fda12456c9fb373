"""What is received from ROS 2, and which of several senders is followed.

If a joystick's and a planner's node both send, the robot would do half of each. So the first is followed until it is
silent. For priorities between them, put twist_mux in front of the bridge.
"""

import logging
from collections.abc import Callable, Iterable
from typing import Any, Final

SILENT_S: Final = 0.5
"""A node that is silent for longer moves nothing. A velocity holds for this time, too."""

_log: Final = logging.getLogger(__name__)


class Rivals:
    """The senders of one stream of messages."""

    def __init__(self) -> None:
        self._sender = b""
        self._latest_s = float("-inf")

    def may_send(self, sender: bytes, now_s: float) -> bool:
        """Return whether to follow this sender's message. An unreported sender has an empty GID."""
        return sender == self._sender or now_s - self._latest_s > SILENT_S

    def sent(self, sender: bytes, now_s: float) -> None:
        """Record that the sender's message was followed."""
        self._sender, self._latest_s = sender, now_s


def read_each(received: Iterable[Any], take: Callable[[Any], object]) -> None:
    """Call `take` for each message until `received` ends. An error in one is logged and does not end the topic."""
    for each in received:
        try:
            take(each)
        except Exception:
            _log.exception("a message could not be handled")
