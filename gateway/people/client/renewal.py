"""When a lease is renewed, and when it counts as lost. Pure: `now_s` is by any clock that never goes back.

The gateway's answer decides, or its silence for as long as the lease lives: an event may be forged or lost, and only
brings the next renewal forward.
"""

import math
from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from gateway.errors import LeaseLostError
from schemas.words import Reason

if TYPE_CHECKING:
    from schemas.lease import LeaseAck

RENEWALS: Final = 3
"""Renewals in each time to live, so two may be lost."""
LEAST_ANSWER_S: Final = 0.1
"""The shortest wait for an answer to a renewal. A third of the shortest time to live (200 ms) would be less."""


class Holds(Enum):
    """The lease's state for this client."""

    NOT_YET = auto()
    YES = auto()
    LOST = auto()
    HANDED_OVER = auto()
    RELEASED = auto()


class Renewal:
    """The state of one lease. For one thread at a time.

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

    def __init__(self) -> None:  # mutants accepted (Delete_USub, Forget, Step): set before it is read
        self.holds = Holds.NOT_YET
        self.ttl_ms = 0.0
        self.lost: LeaseLostError | None = None
        """How the lease was lost."""
        self.gives = False
        """Whether a hand-over is in progress, during which a rejected renewal is no loss."""
        self.due_s = math.inf
        """When the next renewal is due (seconds, by the caller's clock)."""
        self._confirmed_s = -math.inf

    def granted(self, ttl_ms: float, asked_s: float) -> None:
        """Record that the lease is ours, from `asked_s` on, when the request was sent."""
        self.holds, self.ttl_ms, self._confirmed_s = Holds.YES, ttl_ms, asked_s
        self.asked(asked_s)

    @property
    def answer_s(self) -> float:
        """The longest wait for the answer to a renewal."""
        return max(self._period_s, LEAST_ANSWER_S)

    def asked(self, now_s: float) -> None:
        self.due_s = now_s + self._period_s

    def answered(self, ack: "LeaseAck", asked_s: float) -> None:
        """Take the gateway's answer to a renewal sent at `asked_s`."""
        if ack.accepted:
            self._confirmed_s = max(self._confirmed_s, asked_s)
        else:
            self._lose(ack.reason or "", f"the lease is lost, {ack.holder or 'nobody'} holds it now", ack.holder)

    def unanswered(self, now_s: float) -> None:
        """Record that a renewal has had no answer until now."""
        if now_s - self._confirmed_s > self.ttl_ms / 1000:
            detail = f"the gateway has not answered for {self.ttl_ms:g} ms, and the lease lives no longer than that"
            self._lose(Reason.NO_LEASE, detail, None)

    def end(self, how: Holds) -> None:
        """Record that we gave it up. A lost lease stays lost."""
        if self.holds is Holds.YES:
            self.holds = how

    @property
    def elsewhere(self) -> bool:
        """Whether another client has it by a hand-over or a takeover, and so the legs."""
        taken = self.holds is Holds.LOST and self.lost is not None and self.lost.holder is not None
        return taken or self.holds is Holds.HANDED_OVER

    @property
    def _period_s(self) -> float:
        return self.ttl_ms / 1000 / RENEWALS

    def _lose(self, reason: str, detail: str, holder: str | None) -> None:
        if self.holds is Holds.YES and not self.gives:
            self.lost, self.holds = LeaseLostError(reason, detail, holder), Holds.LOST
