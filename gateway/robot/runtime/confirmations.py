"""Who waits for the power board to confirm that servos are off. Called by the owner of the state.

While a question is open, it serves all who ask for the same servos. Each waiting answer keeps a query of Zenoh's, and
with it up to 64 KiB in which the query was received. So a flood of acknowledged emergency stops with a silent board
would take all memory: only MOST_ASKERS wait for a question, and further ones learn at once that nothing is confirmed.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.robot.power.offs import Confirmed

MOST_ASKERS: Final = 64
"""As many as there are sessions (`limits.MAX_SESSIONS`); they keep 4 MiB at most."""
MOST_QUESTIONS: Final = 32
"""Open at a time: each leg, each servo and the whole robot, 25, and some that were fed and stopped again."""

Then = Callable[[bool, float | None], None]
"""Called once: whether the board has confirmed it, and how many ms after it was asked for."""


@dataclass(slots=True)
class _Question:
    """Whether these servos are off, and who asks: since when (ns), and the callback."""

    servos: frozenset[int]
    asked_ns: int
    askers: list[tuple[int, Then]] = field(default_factory=list)
    takes_more: bool = True


class Confirmations:
    """The open questions to a power board."""

    def __init__(self, ask: Callable[[frozenset[int], int, int], None]) -> None:
        """`ask` the board about these servos, since this time (ns), by this token."""
        self._ask = ask
        self._token = 0
        self._open: dict[int, _Question] = {}

    def wait(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed that these are off, or it is too late for it."""
        wanted = frozenset(servos)
        question = next((each for each in self._open.values() if each.takes_more and each.servos == wanted), None)
        full = len(self._open) >= MOST_QUESTIONS if question is None else len(question.askers) >= MOST_ASKERS
        if full:
            then(False, None)
            return
        if question is None:
            self._token += 1
            question = self._open[self._token] = _Question(wanted, asked_ns)
            self._ask(wanted, asked_ns, self._token)
        question.askers.append((asked_ns, then))

    def feeds(self, servos: frozenset[int]) -> None:
        """These are to be fed: a later Stop of them needs a question of its own."""
        for each in self._open.values():
            if not servos.isdisjoint(each.servos):
                each.takes_more = False

    def answered(self, answer: Confirmed) -> None:
        """The board's answer, or that it is too late for one."""
        question = self._open.pop(answer.token, None)
        if question is None:
            return
        for asked_ns, then in question.askers:
            ms = None if answer.ms is None else answer.ms - (asked_ns - question.asked_ns) / NS_PER_MS
            if ms is not None and ms < 0:  # the board's answer is older than this asker's Stop
                self.wait(question.servos, asked_ns, then)
            else:
                then(answer.confirmed, ms)

    def close(self) -> None:
        """Nobody waits any longer: nothing is confirmed."""
        for token in tuple(self._open):
            self.answered(Confirmed(token, confirmed=False, ms=None))
