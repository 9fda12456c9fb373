"""When a lease is renewed, and when it counts as lost. Pure: `now_s` is by any clock that never goes back.

The gateway's answer decides, or its silence for as long as the lease lives: an event may be forged or lost, and only
brings the next renewal forward.
"""

import math
from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from gateway.errors import LeaseLostError
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from schemas.lease import LeaseAck

RENEWALS: Final = 3
"""In each time to live: two may be lost."""
LEAST_ANSWER_S: Final = 0.1
"""For an answer to a renewal; with the shortest time to live (200 ms) a third of it would be less."""
TRY_AGAIN_S: Final = 0.3
"""While it waits to be handed over: how often it is tried besides what events tell."""


class Holds(Enum):
    """Whether a lease is ours."""

    NOT_YET = auto()
    YES = auto()
    LOST = auto()
    HANDED_OVER = auto()
    RELEASED = auto()


class Renewal:
    """What is known of one lease. For one thread at a time.

    >>> renewal = Renewal()
    >>> renewal.granted(ttl_ms=900, asked_s=10.0)
    >>> round(renewal.due_s, 3)
    10.3
    >>> for now_s in (10.8, 10.91):            # nobody answers
    ...     renewal.unanswered(now_s)
    ...     renewal.holds.name
    'YES'
    'LOST'
    """

    def __init__(self) -> None:
        self.holds = Holds.NOT_YET
        self.ttl_ms = 0.0
        self.lost: LeaseLostError | None = None
        """How it was lost."""
        self.gives = False
        """Away: a renewal that is rejected meanwhile is no loss."""
        self.due_s = math.inf
        """When the next renewal leaves."""
        self._confirmed_s = -math.inf

    def granted(self, ttl_ms: float, asked_s: float) -> None:
        """It is ours, by a request that left at `asked_s`: it may live that much shorter than we know."""
        self.holds, self.ttl_ms, self._confirmed_s = Holds.YES, ttl_ms, asked_s
        self.asked(asked_s)

    @property
    def answer_s(self) -> float:
        """How long an answer to a renewal is waited for."""
        return max(self._period_s, LEAST_ANSWER_S)

    def asked(self, now_s: float) -> None:
        """A renewal leaves now."""
        self.due_s = now_s + self._period_s

    def answered(self, ack: "LeaseAck", asked_s: float) -> None:
        """What the gateway says to a renewal that left at `asked_s`."""
        if ack.accepted:
            self._confirmed_s = max(self._confirmed_s, asked_s)
        else:
            self._lose(ack.reason or "", f"the lease is lost, {ack.holder or 'nobody'} holds it now", ack.holder)

    def unanswered(self, now_s: float) -> None:
        """Nobody has answered a renewal until now."""
        if now_s - self._confirmed_s > self.ttl_ms / 1000:
            detail = f"the gateway has not answered for {self.ttl_ms:g} ms, and the lease lives no longer than that"
            self._lose(Reason.NO_LEASE, detail, None)

    def end(self, how: Holds) -> None:
        """By ourselves. What is lost stays lost."""
        if self.holds is Holds.YES:
            self.holds = how

    @property
    def elsewhere(self) -> bool:
        """Whether it was handed over, or somebody else is known to hold it: the legs are theirs."""
        taken = self.holds is Holds.LOST and self.lost is not None and self.lost.holder is not None
        return taken or self.holds is Holds.HANDED_OVER

    @property
    def _period_s(self) -> float:
        return self.ttl_ms / 1000 / RENEWALS

    def _lose(self, reason: str, detail: str, holder: str | None) -> None:
        if self.holds is Holds.YES and not self.gives:
            self.lost, self.holds = LeaseLostError(reason, detail, holder), Holds.LOST


class Waiting:
    """For a lease that somebody else holds: whom to ask for it, and when to try again."""

    def __init__(self, end_s: float) -> None:
        self._end_s = end_s
        self._asked: str | None = None

    def asks(self, holder: str | None) -> bool:
        """Whether that holder is to be asked: once, and so is whoever has become the holder meanwhile."""
        new = holder != self._asked
        self._asked = holder
        return new

    def pause_s(self, now_s: float) -> float:
        """How long until it is tried again; 0 once the time is over."""
        return max(0.0, min(TRY_AGAIN_S, self._end_s - now_s))
