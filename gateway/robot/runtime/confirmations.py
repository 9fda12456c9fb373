"""Answers that wait until the power board confirms that servos are off. For the owner of the state.

An open question serves everyone who asks about the same servos. A waiting answer keeps a Zenoh query and up to 64 KiB
of its receive buffer. With a silent board, a flood of acknowledged emergency stops would fill the memory. Therefore at
most MOST_ASKERS wait for a question; further ones are answered at once that nothing is confirmed.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.robot.power.offs import Confirmed

MOST_ASKERS: Final = 64
"""One for each session (`limits.MAX_SESSIONS`); together they keep 4 MiB at most."""
MOST_QUESTIONS: Final = 32
"""Open at a time: 25 for each leg, each servo and the whole robot, and some for servos powered and stopped again."""

Then = Callable[[bool, float | None], None]
"""Called once: whether the board has confirmed it, and how many ms after the Stop was received (None: it has not)."""


@dataclass(slots=True)
class _Question:
    """A question whether these servos are off; for each asker, when its Stop was received (ns), and its callback."""

    servos: frozenset[int]
    asked_ns: int
    askers: list[tuple[int, Then]] = field(default_factory=list)
    takes_more: bool = True


class Confirmations:
    """The open questions to a power board."""

    def __init__(self, ask: Callable[[frozenset[int], int, int], None]) -> None:
        """`ask(servos, since_ns, token)` asks the board; its answer carries the token."""
        self._ask = ask
        self._token = 0
        self._open: dict[int, _Question] = {}

    def wait(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed that these servos are off, or the time for that is over.

        `asked_ns` is when the Stop was received. With too many questions or askers, `then` is called at once.
        """
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
        """Record that these servos are powered again. A later Stop of them needs a new question."""
        for each in self._open.values():
            if not servos.isdisjoint(each.servos):
                each.takes_more = False

    def answered(self, answer: Confirmed) -> None:
        """Take the board's answer, or the end of the time for one."""
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
        """Call all callbacks: nothing is confirmed."""
        for token in tuple(self._open):
            self.answered(Confirmed(token, confirmed=False, ms=None))
