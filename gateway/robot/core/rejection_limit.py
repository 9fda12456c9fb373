"""Limits how many events of a source are published, and counts those that are left out. Pure."""

from dataclasses import dataclass, field
from typing import Final

from gateway.allowance import Allowance
from schemas.telemetry import Kind

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
"""Events that clients can cause at any rate. Each kind has a limit of its own, so that a flood of one hides no other:
two people who fight for a leg hide no takeover."""

EVENTS_A_SECOND: Final = 10
EVENTS_AT_ONCE: Final = 10
SOURCES_COUNTED: Final = 64
"""Sources counted separately at a time; all further ones share one allowance."""


@dataclass(slots=True)
class _Source:
    allowance: Allowance = field(default_factory=lambda: Allowance(EVENTS_A_SECOND, EVENTS_AT_ONCE))
    left_out: int = 0


class RejectionLimit:
    """Decides which events are published: of each source ten at once, and ten a second. Memory is bounded."""

    def __init__(self) -> None:
        self._sources: dict[str | None, _Source] = {}

    def admit(self, source: str | None, now_ns: int) -> int | None:
        """How many of this source were left out before this one, which is published; None: leave this one out, too."""
        if source not in self._sources and len(self._sources) >= SOURCES_COUNTED:
            self._sources = {
                name: known for name, known in self._sources.items() if not known.allowance.is_full(now_ns)
            }
            if len(self._sources) >= SOURCES_COUNTED:
                source = None
        known = self._sources.setdefault(source, _Source())
        if not known.allowance.take(now_ns):
            known.left_out += 1
            return None
        left_out, known.left_out = known.left_out, 0
        return left_out
