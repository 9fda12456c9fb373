"""Who commands, for people: nothing of it decides what is sent."""

from collections.abc import Callable
from typing import Final

from gateway.robot.core.events import Announce
from gateway.robot.core.intake import named_source
from gateway.robot.core.message import Received
from gateway.robot.core.rejection_limit import RejectionLimit
from schemas.telemetry import Kind, Reason

Tell = Callable[[Kind, str, str | None, str | None, Reason | None, int, tuple[int, ...]], None]


LIMITED: Final = (
    Kind.COMMAND_REJECTED,
    Kind.SOURCE_CHANGED,
    Kind.OVERFLOW,
    Kind.LEASE_ACQUIRED,
    Kind.LEASE_RELEASED,
    Kind.LEASE_TAKEN,
    Kind.LEASE_ASKED,
    Kind.CALIBRATED,
    Kind.BUTTON_REGISTERED,
    Kind.BUTTON_LEFT,
    Kind.BUTTON_RETURNED,
)
"""What others can bring about as often as they like. Each kind has a limit of its own, so that none is left out for
another's sake: two people who fight for a leg hide no takeover."""


class Sources:
    """Names the source of what is announced, and limits how often each source is reported for each kind."""

    def __init__(self) -> None:
        self._limits = {kind: RejectionLimit() for kind in LIMITED}
        self._unread: Received | None = None
        self._estop: str | None = None

    def note_estop(self, received: Received) -> None:
        """An emergency stop is requested. Its payload is left unread: its Stops come first."""
        self._unread = received

    @property
    def estop(self) -> str | None:
        """Who requested the latest emergency stop; to be asked after its Stops are written."""
        if self._unread is not None:
            self._estop = named_source(self._unread.payload) or self._unread.source
            self._unread = None
        return self._estop

    def announce(self, announce: Announce, now_ns: int, tell: Tell) -> None:
        """Tell it, with its source, unless too many of this kind were."""
        source = self.estop if announce.kind is Kind.ESTOP_ENGAGED else announce.source
        left_out = self.admit(announce.kind, source, now_ns)
        if left_out is not None:
            tell(announce.kind, announce.detail, source, announce.key, announce.reason, left_out, announce.legs)

    def admit(self, kind: Kind, source: str | None, now_ns: int) -> int | None:
        """How many events of this kind and source were left out before this one; None: leave this one out, too."""
        limit = self._limits.get(kind)
        return 0 if limit is None else limit.admit(source, now_ns)
