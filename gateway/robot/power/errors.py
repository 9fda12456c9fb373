"""The power board's errors: what it has blocked for them, and how they are deleted. Pure.

The board keeps four kinds. It shows the newest at the first question, the next one at the next, and deletes the one
that it has shown last. An output that was blocked for it comes on at once then, if the board's mask has it.
"""

from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ASK_ERROR, CLEAR_ERROR, OUTPUTS, TWO_BOARDS, BoardError, CanFrame, explained

CLEAR_NS: Final = 50 * NS_PER_MS
CLEAR_TRIES: Final = 40
"""Requests to show or delete errors: a board keeps four kinds, and a fifth of the answers may be lost."""


class BoardErrors:
    """Those of one board."""

    def __init__(self) -> None:
        """None is known yet."""
        self._errors: dict[int, BoardError] = {}
        """By code, as one error with all that it was seen to concern."""
        self._reported: dict[int, int] = {}
        """By code, the mask that was reported: an error that lasts is reported once, however often it is shown."""
        self._shown: int | None = None
        """The code of the error that the board has shown last, and will delete."""
        self._tries = 0
        self._due_ns = 0
        self._next = ASK_ERROR

    @property
    def blocked(self) -> dict[int, str]:
        """By output, from 0 on: why the board feeds it no more."""
        found: dict[int, str] = {}
        for error in self._errors.values():
            why, mask = explained(error)
            found = {place: why for place in range(OUTPUTS) if mask >> place & 1} | found
        return found

    @property
    def mask(self) -> int:
        """The outputs that are blocked."""
        mask = 0
        for error in self._errors.values():  # thousands of times a second in a flood
            mask |= explained(error)[1]
        return mask

    @property
    def two_boards(self) -> bool:
        """Whether two boards answer, so that no answer counts."""
        return TWO_BOARDS in self._errors

    @property
    def due_ns(self) -> int | None:
        """While they are deleted: when `next_frame` has something to send. None: they are not."""
        return self._due_ns if self._tries else None

    def delete(self, now_ns: int) -> None:
        """From now on, until the board has none."""
        self._errors.pop(TWO_BOARDS, None)
        self._reported.pop(TWO_BOARDS, None)
        self._tries = CLEAR_TRIES
        self._due_ns = now_ns
        self._next = ASK_ERROR

    def next_frame(self, now_ns: int, *, without: bool) -> CanFrame | None:
        """What leaves now. `without`: the board's mask has certainly none of what is blocked."""
        if not self._tries or now_ns < self._due_ns:
            return None
        self._tries -= 1
        self._due_ns = now_ns + CLEAR_NS
        frame, self._next = self._next, ASK_ERROR
        return frame if without or frame is ASK_ERROR else None

    def shown(self, error: BoardError, now_ns: int) -> tuple[str, int, bool]:
        """The board has this one. Return its sentence, the outputs that it alone blocks, and whether it is new."""
        before, code = self.mask, error.code
        known = self._errors.get(code, error)
        self._errors[code] = BoardError(code, known.mask | error.mask)
        self._shown = code
        if self._tries:
            self._next = CLEAR_ERROR
            self._due_ns = now_ns
        reported = self._reported.get(code)
        self._reported[code] = (reported or 0) | error.mask
        new = reported is None or bool(error.mask & ~reported)
        return explained(error)[0], self.mask & ~before, new

    def deleted(self, now_ns: int) -> None:
        """The one shown last is deleted, and blocks nothing any more; there may be others."""
        if self._shown is not None:
            self._errors.pop(self._shown, None)
            self._shown = None
        self._next = ASK_ERROR
        self._due_ns = now_ns

    def none_left(self) -> None:
        """The board has none. That two boards answer is no error of theirs, and ends with `delete`."""
        kept = {TWO_BOARDS} if self.two_boards else set()
        self._reported = {code: mask for code, mask in self._reported.items() if code in kept}
        self._errors = {code: error for code, error in self._errors.items() if code in kept}
        self._tries = 0
