"""How long a question waits, when it is sent again or by another way, and which answer counts; time is an argument.

Without access control anybody may answer on the gateway's keys. The program that was dialled answers for itself;
another's answer counts only when all whom that query reached have had their say, for the gateway may be behind the
program that was dialled.
"""

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Generic, TypeVar

A = TypeVar("A")

RESEND_S: Final = 0.05
"""A client that lost the gateway tries to reach it again after 0.1 s (`gateway.zenoh_config`)."""
ATTEMPT_S: Final = 1.0
"""After so long without an answer a Stop is requested again: the link may be dead without a sign.

The answer to an earlier attempt counts as well: on a slow bus six Stops take longer than this.
"""
OTHER_WAY_S: Final = 0.2
"""After so long without an answer a Stop is sent by another session as well.

An answer takes milliseconds. Zenoh notices a dead link only after its lease, and then tries the hosts in turn.
"""


class QuestionStep(Enum):
    """What to do next."""

    WAIT = auto()
    """For what comes in, until `next_s` at most."""
    AGAIN = auto()
    """Send it again, by each session."""
    OTHER_WAY = auto()
    """Search for another session, once."""
    OVER = auto()
    """`answer` is all that there is."""


@dataclass(eq=False, slots=True)
class Query(Generic[A]):
    """One of a question's queries, until it has ended: all have answered or declined, or its link is lost."""

    foreign: A | None = None
    """The first answer of a program that was not dialled."""


class Patience(Generic[A]):
    """One question's."""

    def __init__(self, now_s: float, end_s: float, *, again: bool, other_ways: bool) -> None:
        """`again`: it is sent until it is answered, or `end_s`; `other_ways`: there are other hosts to be tried."""
        self._end_s = end_s
        self._again = again
        self._again_s = now_s + ATTEMPT_S if again else end_s
        self._other_way_s = now_s + OTHER_WAY_S if other_ways else end_s
        self._searches = not other_ways
        self._sent_s = now_s
        self._foreign: A | None = None
        self._over = False
        self.under_way = 0
        self.answer: A | None = None
        """The one that counts."""

    def sent(self, now_s: float) -> Query[A]:
        """A query has left."""
        self._sent_s = now_s
        self.under_way += 1
        return Query()

    def replied(self, query: Query[A], answer: A, *, own: bool) -> None:
        """Somebody has answered; `own`: the program that was dialled, or one of which nobody knows otherwise."""
        query.foreign = query.foreign or answer
        self._foreign = self._foreign or answer
        if own:
            self._finish(answer)

    def ended(self, query: Query[A], now_s: float) -> None:
        """Zenoh ends a query at once if there is no link, or if it is lost."""
        self.under_way -= 1
        self._finish(query.foreign)
        if self.under_way:
            return
        self._over = self._over or not self._again
        self._again_s = min(self._again_s, self._sent_s + RESEND_S)
        self._other_way_s = min(self._other_way_s, now_s)

    @property
    def next_s(self) -> float:
        """When to look again at the latest."""
        return min(self._end_s, self._again_s, self._end_s if self._searches else self._other_way_s)

    def step(self, now_s: float) -> QuestionStep:
        """What to do now; what it says is taken as done."""
        if now_s >= self._end_s:
            self._finish(self._foreign)
            self._over = True
        if self._over or self.answer is not None:
            return QuestionStep.OVER
        if not self._searches and now_s >= self._other_way_s:
            self._searches = True
            return QuestionStep.OTHER_WAY
        if now_s >= self._again_s:
            self._again_s = now_s + ATTEMPT_S
            return QuestionStep.AGAIN
        return QuestionStep.WAIT

    def _finish(self, answer: A | None) -> None:
        if self.answer is None:
            self.answer = answer
