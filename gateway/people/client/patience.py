"""Decides how long a question waits, when it is resent, and which answer counts. Pure: time is an argument.

Without access control any program may answer on the gateway's keys. An answer of the dialled program counts at once.
Another program's counts only after all programs that the query reached have answered or declined: the gateway may be
behind the dialled program.
"""

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Generic, TypeVar

A = TypeVar("A")

RESEND_S: Final = 0.05
"""A client without a link tries again after 0.1 s (`gateway.zenoh.config`)."""
ATTEMPT_S: Final = 1.0
"""After this time without an answer a Stop is requested again, since the link may be dead unnoticed.

An answer to an earlier attempt counts, too: on a slow bus six Stops take longer than this.
"""
OTHER_WAY_S: Final = 0.2
"""After this time without an answer a Stop is also sent by another session.

An answer takes milliseconds. Zenoh notices a dead link only after its lease, and then tries the hosts in turn.
"""


class QuestionStep(Enum):
    """The next step of a question."""

    WAIT = auto()
    """Wait for replies, until `next_s` at most."""
    AGAIN = auto()
    """Resend it by each session."""
    OTHER_WAY = auto()
    """Search for another session, once."""
    OVER = auto()
    """`answer` is final."""


@dataclass(eq=False, slots=True)
class Query(Generic[A]):  # mutants accepted (RemoveDecorator): without slots and equality it behaves alike
    """One query of a question. It ends when all programs have answered or declined, or its link is lost."""

    foreign: A | None = None
    """The first answer from a program that was not dialled."""


class Patience(Generic[A]):  # mutants accepted (Forget): the first query sets the time
    """The state of one question; `A` is its answer."""

    def __init__(self, now_s: float, end_s: float, *, again: bool, other_ways: bool) -> None:
        """`again`: resend it until it is answered, or `end_s`; `other_ways`: other hosts can be tried."""
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
        """The answer that counts, or None so far."""

    def sent(self, now_s: float) -> Query[A]:
        self._sent_s = now_s
        self.under_way += 1
        return Query()

    def replied(self, query: Query[A], answer: A, *, own: bool) -> None:
        """Take a program's answer. `own`: it is, or may be, the dialled program."""
        query.foreign = query.foreign or answer
        self._foreign = self._foreign or answer
        if own:
            self._finish(answer)

    def ended(self, query: Query[A], now_s: float) -> None:
        """Take a query's end, which without a link comes at once."""
        self.under_way -= 1
        self._finish(query.foreign)
        if self.under_way:
            return
        self._over = self._over or not self._again
        self._again_s = min(self._again_s, self._sent_s + RESEND_S)
        self._other_way_s = min(self._other_way_s, now_s)

    @property
    def next_s(self) -> float:
        """When to call `step` again at the latest."""
        return min(self._end_s, self._again_s, self._end_s if self._searches else self._other_way_s)

    def step(self, now_s: float) -> QuestionStep:
        """Return the step to do now. It counts as done."""
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
