"""Which servos a lost Stop may have named: pure.

A flood pushes older messages out of its key's ring, and a Stop may be among them. It would have stopped what its key
names, until a Start on the same key came after it. So these servos are stopped, except those that one of the messages
that were left starts.
"""

from typing import Final

from gateway.model.frames import OP_START
from gateway.robot.core.events import Targets
from gateway.robot.core.targets import stops_of
from schemas.keys import COMMAND_KEYS

DETAIL: Final = (
    "messages were lost on the way to the gateway: more came at once than it keeps, and a stop may be among them, "
    "so it counts as received; start again when the link carries what is sent"
)


class Losses:
    """The key whose messages are being dealt with after some were lost (else ""), and the Stops that it needs."""

    def __init__(self) -> None:
        self.key = ""
        self._stops: Targets = ()

    def note(self, key: str) -> None:
        """Messages that were put on `key` were lost, older than those that are dealt with next."""
        self.key, self._stops = key, stops_of(COMMAND_KEYS[key])

    def accepted(self, targets: Targets) -> None:
        """One of the next messages was carried out."""
        started = {servo_id for servo_id, op in targets if op.op is OP_START}
        self._stops = tuple(stop for stop in self._stops if stop[0] not in started)

    def take(self) -> tuple[str, Targets]:
        """The key, and what is still to be stopped, after the last of these messages; forgets it."""
        found = self.key, self._stops
        self.key, self._stops = "", ()
        return found
