"""The power board's errors: which outputs they block, and how they are deleted. Pure.

The board keeps four kinds of errors. Each question shows one, the newest first; a deletion deletes the one shown last.
Outputs that the error blocked then come on at once, if they are in the board's mask.
"""

from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ASK_ERROR, CLEAR_ERROR, OUTPUTS, TWO_BOARDS, BoardError, CanFrame, explained

CLEAR_NS: Final = 50 * NS_PER_MS
CLEAR_TRIES: Final = 40
"""Requests to show or delete errors: a board keeps four kinds, and one in five answers may be lost."""


class BoardErrors:
    def __init__(self) -> None:  # mutants accepted (Forget, Step): `delete` sets both
        self._errors: dict[int, BoardError] = {}
        """The errors by code, each with all outputs that it was shown with."""
        self._reported: dict[int, int] = {}
        """The reported mask by code, so that a lasting error is reported once."""
        self._shown: int | None = None
        """The code of the error shown last, which a deletion would delete."""
        self._tries = 0
        self._due_ns = 0
        self._next = ASK_ERROR

    @property
    def blocked(self) -> dict[int, str]:
        """The blocked outputs, from 0 on, each with the reason."""
        found: dict[int, str] = {}
        for error in self._errors.values():
            why, mask = explained(error)
            found = {place: why for place in range(OUTPUTS) if mask >> place & 1} | found
        return found

    @property
    def mask(self) -> int:
        mask = 0
        for error in self._errors.values():  # thousands of times a second in a flood
            mask |= explained(error)[1]
        return mask

    @property
    def two_boards(self) -> bool:
        """Whether two boards answer. Then no answer counts."""
        return TWO_BOARDS in self._errors

    @property
    def due_ns(self) -> int | None:
        """When to call `next_frame` next, or None if no errors are being deleted."""
        return self._due_ns if self._tries else None

    def delete(self, now_ns: int) -> None:
        """Delete errors from now on, until the board has none left."""
        self._errors.pop(TWO_BOARDS, None)
        self._reported.pop(TWO_BOARDS, None)
        self._tries = CLEAR_TRIES
        self._due_ns = now_ns
        self._next = ASK_ERROR

    def next_frame(self, now_ns: int, *, without: bool) -> CanFrame | None:
        """Return the frame to send now, or None. `without`: the board's mask certainly has no blocked output."""
        if not self._tries or now_ns < self._due_ns:
            return None
        self._tries -= 1
        self._due_ns = now_ns + CLEAR_NS
        frame, self._next = self._next, ASK_ERROR
        return frame if without or frame is ASK_ERROR else None

    def shown(self, error: BoardError, now_ns: int) -> tuple[str, int, bool]:
        """Take an error of the board. Return its sentence, the newly blocked outputs, and whether the error is new."""
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
        """Record that the error shown last is deleted and blocks nothing. Others may be left."""
        if self._shown is not None:
            self._errors.pop(self._shown, None)
        self._next = ASK_ERROR
        self._due_ns = now_ns

    def none_left(self) -> None:
        """Record that the board has no errors. Two answering boards are not its error; only `delete` ends that one."""
        kept = {TWO_BOARDS} if self.two_boards else set()
        self._reported = {code: mask for code, mask in self._reported.items() if code in kept}
        self._errors = {code: error for code, error in self._errors.items() if code in kept}
        self._tries = 0
