"""The power board's errors: which servos they block, and how they are deleted. Pure.

The board keeps four kinds of errors. Each question shows one, the newest first; a deletion deletes the one shown last.
Outputs that the error blocked then come on at once, if they are in the board's mask. So an error blocks its servos
until the owner has it deleted, even if somebody deletes it at the board.
"""

from collections.abc import Mapping
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ASK_ERROR, CLEAR_ERROR, CanFrame

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
