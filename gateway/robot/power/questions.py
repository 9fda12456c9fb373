"""Chooses the next question to the power board, and derives what its answers prove. No I/O, no clock.

Questions about currents are always asked. A question about rails is asked only after its last one was answered. So its
answer proves that all earlier frames have reached the board, even if a link pauses and then delivers older answers. If
another node asks the same, the first answer counts as that node's, since its question was received before the answer.

Two answers to one question come from two boards, of which one may power servos while the other confirms. One second
answer proves nothing: on slcan, `stop-servos` and the gateway read one terminal, and its questions are not seen here.

The board keeps four kinds of errors. Each question shows one, the newest first; a deletion deletes the one shown last.
Outputs that the error blocked then come on at once, if they are in the board's mask. So an error blocks its servos
until the owner has it deleted, even if somebody deletes it at the board.
"""

from collections import deque
from collections.abc import Mapping
from itertools import cycle
from typing import Final

from gateway.model.power_board import ASK_CURRENTS, ASK_ERROR, ASK_RAILS, CLEAR_ERROR, CanFrame
from gateway.rate_limit import NS_PER_MS

ASK_NS: Final = 10 * NS_PER_MS
SILENT_QUESTIONS: Final = 10
SILENT_NS: Final = 100 * NS_PER_MS
"""After this many unanswered questions and this much time, the board counts as silent. A restart takes it longer."""
LIKELY_SILENT: Final = 5
"""After this many unanswered questions, none about rails is asked: some must be left to prove something later."""
LOST_NS: Final = 300 * NS_PER_MS
"""An unanswered question of this age is lost if a later one was answered, since links keep the order."""
DOUBLE_NS: Final = 10 * NS_PER_MS
"""The longest time between two answers to one question, since boards answer in their receive interrupt."""
DOUBLES: Final = 3
FORGOTTEN_NS: Final = 2000 * NS_PER_MS
"""An unanswered question of this age is lost in any case: else a link that lost six answers could confirm nothing."""
_ROUND: Final = (*ASK_CURRENTS, None, *ASK_CURRENTS, ASK_ERROR)
"""The questions in turn; None: one about rails."""


class BoardQuestions:
    """One question every 10 ms, and one after each mask."""

    def __init__(self) -> None:  # mutants accepted (Step): a nanosecond
        self.due_ns = 0
        self.reached = 0
        """The number of the newest mask that has certainly reached the board."""
        self.reached_ns = 0
        """When the question that proves this was asked."""
        self.doubles = 0
        """How many of the newest questions were answered twice. From DOUBLES on it stays."""
        self.answered_ns: int | None = None
        """When the board last answered anything."""
        self._unanswered = 0
        self._round = cycle(_ROUND)
        self._rails = deque(ASK_RAILS)
        """In the order in which they are asked."""
        self.asked: dict[CanFrame, tuple[int, int]] = {}
        """Unanswered questions about rails: when each was asked, and the number of the newest mask then."""
        self._foreign: dict[CanFrame, tuple[int, int]] = {}
        """Other nodes' questions about rails: how many are unanswered, and when the newest was received."""
        self._latest: tuple[CanFrame, int] | None = None
        """The newest answer to a known question, and when it was received; None after a second answer to it."""

    @property
    def two_boards(self) -> bool:
        """Whether DOUBLES questions in a row were answered twice, since `doubles` was set to 0."""
        return self.doubles >= DOUBLES

    def next(self, newest: int, now_ns: int) -> list[CanFrame]:
        """Return the question in turn, and count it as sent. `newest` is the number of the newest mask."""
        self.due_ns = now_ns + ASK_NS
        self._unanswered += 1
        question = next(self._round)
        return [question] if question else self.about_rails(newest, now_ns) or [ASK_ERROR]

    def about_rails(self, newest: int, now_ns: int) -> list[CanFrame]:
        """Return a question whose answer proves that mask number `newest` has reached the board, if one is free."""
        for question in tuple(self._rails) if self._unanswered <= LIKELY_SILENT else ():
            self._rails.rotate(-1)  # mutants accepted (Delete_USub): each is asked as often
            if question not in self.asked or self._is_lost(self.asked[question][0], now_ns):
                self.asked[question] = (now_ns, newest)
                return [question]
        return []

    def _is_lost(self, asked_ns: int, now_ns: int) -> bool:
        return now_ns - asked_ns >= (LOST_NS if self.reached_ns > asked_ns else FORGOTTEN_NS)

    def answered(self, now_ns: int) -> None:
        self.answered_ns = now_ns
        self._unanswered = 0

    def asked_by_another(self, question: CanFrame, now_ns: int) -> None:
        """Record another node's question. Only questions about rails matter."""
        if question in ASK_RAILS:
            self._foreign[question] = (self._foreign_unanswered(question, now_ns) + 1, now_ns)

    # mutants accepted (Step): none are none, whenever the newest was received
    def _foreign_unanswered(self, question: CanFrame, now_ns: int) -> int:
        number, newest_ns = self._foreign.get(question, (0, 0))
        return number if now_ns - newest_ns < FORGOTTEN_NS else 0

    # mutants accepted (Step): less than what has reached the board
    def answered_about_rails(self, question: CanFrame, now_ns: int) -> None:
        others, ours = self._foreign_unanswered(question, now_ns), question in self.asked
        if others:
            self._foreign[question] = (others - 1, self._foreign[question][1])
        else:
            asked_ns, newest = self.asked.pop(question, (0, 0))
            self.reached_ns = max(self.reached_ns, asked_ns)
            self.reached = max(self.reached, newest)
        if self.two_boards:
            return
        if others or ours:
            self.doubles = 0 if self._latest else self.doubles
            self._latest = (question, now_ns)
        elif self._latest and self._latest[0] == question and now_ns - self._latest[1] < DOUBLE_NS:
            self._latest = None
            self.doubles += 1

    def silent(self, now_ns: int) -> bool:
        """Return whether the board is silent. Call it every 10 ms.

        A due question that was not fetched counts as unanswered: the sender hangs. Time alone does not make the board
        silent, since this process may have been suspended.
        """
        if now_ns >= self.due_ns + 2 * ASK_NS:
            self.due_ns = now_ns - ASK_NS
            self._unanswered += 1
        # mutants accepted (Step): a nanosecond
        return self._unanswered >= SILENT_QUESTIONS and now_ns - (self.answered_ns or 0) >= SILENT_NS


# ---- errors

CLEAR_NS: Final = 50 * NS_PER_MS
CLEAR_TRIES: Final = 40
"""Requests to show or delete errors: a board keeps four kinds, and one in five answers may be lost."""


class BoardErrors:
    def __init__(self) -> None:
        self._blocked: dict[int, dict[int, str]] = {}
        """For each code, the blocked servos, and why."""
        self._shown = 0  # mutants accepted (Step): no error was shown
        """The code of the error shown last, which a deletion would delete."""
        self._tries = 0
        self._due_ns = 0  # mutants accepted (Forget, Step): `delete` sets it
        self._next = ASK_ERROR  # mutants accepted (Forget): `delete` sets it

    @property
    def blocked(self) -> dict[int, str]:
        """The blocked servos, each with the reason."""
        return {servo: why for servos in self._blocked.values() for servo, why in servos.items()}

    @property
    def due_ns(self) -> int | None:
        """When to call `next_frames` next, or None if no errors are being deleted."""
        return self._due_ns if self._tries else None

    def delete(self, now_ns: int) -> None:
        """Delete errors from now on, until the board has none left."""
        self._tries = CLEAR_TRIES
        self._due_ns = now_ns
        self._next = ASK_ERROR

    def next_frames(self, now_ns: int, *, without: bool) -> list[CanFrame]:
        """Return the frame to send now, if any. `without`: the board's mask certainly has no blocked output."""
        if not self._tries or now_ns < self._due_ns:
            return []
        self._tries -= 1
        self._due_ns = now_ns + CLEAR_NS
        frame, self._next = self._next, ASK_ERROR
        return [frame] if without or frame is ASK_ERROR else []

    def shown(self, code: int, blocked: Mapping[int, str], now_ns: int) -> None:
        """Take an error of the board, which blocks these servos, each with the reason."""
        self._blocked.setdefault(code, {}).update(blocked)
        self._shown = code
        if self._tries:
            self._next = CLEAR_ERROR
            self._due_ns = now_ns

    def deleted(self, now_ns: int) -> None:
        """Record that the error shown last is deleted. Others may be left."""
        if self._tries:
            self._blocked.pop(self._shown, None)
            self._next = ASK_ERROR
            self._due_ns = now_ns

    def none_left(self) -> None:
        """Record that the board has no errors."""
        if self._tries:
            self._blocked.clear()
            self._tries = 0
