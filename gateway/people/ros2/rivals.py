"""Which of several nodes is followed that publish on one topic. Pure: time is an argument.

Two nodes that both send, a joystick's and a planner's, would have the robot do what neither wants: half of each. So the
first is followed until it is silent. Priorities between them are twist_mux's, in front of the bridge.
"""

from typing import Final

SILENT_S: Final = 0.5
"""As long as a velocity holds: a node that is silent for longer moves nothing."""


class Rivals:
    """The senders of one stream of messages."""

    def __init__(self) -> None:
        self._sender = b""
        self._latest_s = float("-inf")

    def may_send(self, sender: bytes, now_s: float) -> bool:
        """Whether its message is followed. A graph that reports no senders has one, with an empty GID."""
        return sender == self._sender or now_s - self._latest_s > SILENT_S

    def sent(self, sender: bytes, now_s: float) -> None:
        """Its message was followed."""
        self._sender, self._latest_s = sender, now_s
