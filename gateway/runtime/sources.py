"""Who commands, for people: nothing of it decides what is sent."""

from collections.abc import Callable
from typing import Final

from gateway.core.events import Announce
from gateway.core.intake import named_source
from gateway.core.message import Received
from gateway.core.rejection_limit import RejectionLimit
from schemas.telemetry import Kind, Reason

Tell = Callable[[Kind, str, str | None, str | None, Reason | None, int, tuple[int, ...]], None]


_LIMITED: Final = frozenset(
    {
        Kind.SOURCE_CHANGED,
        Kind.LEASE_ACQUIRED,
        Kind.LEASE_RELEASED,
        Kind.LEASE_TAKEN,
        Kind.LEASE_ASKED,
        Kind.CALIBRATED,
    }
)
"""What others can bring about as often as they like."""


class Sources:
    """Names the source of what is announced, and says how often legs that change hands are told."""

    def __init__(self) -> None:
        self.rejections = RejectionLimit()
        self._handovers = RejectionLimit()
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
        """Tell it, with its source; of legs and leases that change hands at most ten a second and source."""
        source = self.estop if announce.kind is Kind.ESTOP_ENGAGED else announce.source
        left_out = self._handovers.admit(source, now_ns) if announce.kind in _LIMITED else 0
        if left_out is not None:
            tell(announce.kind, announce.detail, source, announce.key, None, left_out, announce.legs)
