"""The power board's errors: what it has blocked for them, and how they are deleted. Pure.

The board keeps four kinds. It shows the newest at the first question, the next one at the next, and deletes the one
that it has shown last. An output that was blocked for it comes on at once then, if the board's mask has it.
"""

from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ASK_ERROR, CLEAR_ERROR, OUTPUTS, BoardError, CanFrame, explained

CLEAR_NS: Final = 50 * NS_PER_MS
CLEAR_TRIES: Final = 40
"""Requests to show or delete errors: a board keeps four kinds, and a fifth of the answers may be lost."""


class BoardErrors:
    """Those of one board."""

    def __init__(self) -> None:
        """None is known yet."""
        self.blocked: dict[int, str] = {}
        """By output, from 0 on: why the board feeds it no more."""
        self._known: set[BoardError] = set()
        self._tries = 0
        self._due_ns = 0
        self._next = ASK_ERROR

    @property
    def mask(self) -> int:
        """The outputs that are blocked."""
        return sum(1 << place for place in self.blocked)

    @property
    def deletes(self) -> bool:
        """Whether they are being deleted."""
        return self._tries > 0

    @property
    def due_ns(self) -> int | None:
        """When `next_frame` has something to send; None: never."""
        return self._due_ns if self._tries else None

    def delete(self, now_ns: int) -> None:
        """From now on, until the board has none."""
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

    def shown(self, error: BoardError, now_ns: int) -> tuple[str, int] | None:
        """The board has this one. Returns it in words, and what is blocked by it alone; None: it was known."""
        why, mask = explained(error)
        new = mask & ~self.mask
        self.blocked |= {place: why for place in range(OUTPUTS) if new >> place & 1}
        if self._tries:
            self._next = CLEAR_ERROR
            self._due_ns = now_ns
        if error in self._known:
            return None
        self._known.add(error)
        return why, new

    def deleted(self, now_ns: int) -> None:
        """The one shown last is; there may be more."""
        self._next = ASK_ERROR
        self._due_ns = now_ns

    def none_left(self) -> None:
        """The board has none."""
        self._known.clear()
        self.blocked.clear()
        self._tries = 0
