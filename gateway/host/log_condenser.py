"""Fewer log lines for people who read the journal. Pure: records, and times in seconds of a monotonic clock.

* Repeats are counted: of warnings and rejected commands that differ only in numbers, the first in `REPEATS_WINDOW_S`
  is written at once, and the others as one line at its end. Other records, such as an emergency stop, are never
  delayed by this.
* One stop is one line: when all legs fall silent, each has its own event within milliseconds. Records of the
  `GATHER_S` after the first are held back with it, in order. A kill in this time loses these lines; the black box has
  the events.
"""

import copy
import logging
import re
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Final

from schemas.telemetry import Kind

REPEATS_WINDOW_S: Final = 10.0
"""A client that keeps sending on a wrong key causes ten events a second."""
GATHER_S: Final = 0.1
"""Six legs commanded in turn, 50 times a second, fall silent within 20 ms."""
MOST_KINDS: Final = 64
"""Kinds of repeats counted at a time; further ones are written one by one."""
MOST_HELD: Final = 100
"""Lines held back until a stop is complete."""


@dataclass
class _Repeats:
    ends_s: float
    latest: logging.LogRecord
    more: int = 0


class Condenser:
    """Takes each record when it is logged, and returns those to write."""

    def __init__(self) -> None:
        self._repeats: dict[Hashable, _Repeats] = {}
        self._held: list[logging.LogRecord] = []
        self._legs: list[int] = []
        """Further legs of the stop that the first held record reports."""
        self._gathered_s = 0.0

    def take(self, record: logging.LogRecord, now_s: float) -> list[logging.LogRecord]:
        """The records to write now, in order."""
        found = self.due(now_s)
        if self._is_repeated(record, now_s):
            return found
        leg = _silent_leg(record)
        if self._held:
            if leg is not None and len(self._legs) < MOST_HELD:
                self._legs.append(leg)
            else:
                self._held.append(record)
            return [*found, *(self._gathered() if len(self._held) >= MOST_HELD else [])]
        if leg is None:
            return [*found, record]
        self._held, self._gathered_s = [record], now_s + GATHER_S
        return found

    def due(self, now_s: float) -> list[logging.LogRecord]:
        """The records due by time alone: a complete stop, and counted repeats."""
        found = self._gathered() if self._held and now_s >= self._gathered_s else []
        for kind, repeats in list(self._repeats.items()):
            if now_s >= repeats.ends_s:
                if repeats.more:
                    found.append(_counted(repeats))
                    repeats.more, repeats.ends_s = 0, now_s + REPEATS_WINDOW_S
                else:
                    del self._repeats[kind]
        return found

    def due_at_s(self) -> float | None:
        """When to call `due` next; None: not before the next record."""
        times = [repeats.ends_s for repeats in self._repeats.values()]
        return min([*times, self._gathered_s] if self._held else times, default=None)

    def rest(self) -> list[logging.LogRecord]:
        """All unwritten records, for the end of the process."""
        return [*self._gathered(), *(_counted(repeats) for repeats in self._repeats.values() if repeats.more)]

    def _is_repeated(self, record: logging.LogRecord, now_s: float) -> bool:
        if record.levelno != logging.WARNING or getattr(record, "kind", None) not in (None, Kind.COMMAND_REJECTED):
            return False
        fields = (str(getattr(record, name, None)) for name in ("kind", "source", "key", "reason"))
        kind = (record.name, re.sub(r"\d+", "#", record.getMessage()), *fields)
        repeats = self._repeats.get(kind)
        if repeats is None:
            if len(self._repeats) < MOST_KINDS:
                self._repeats[kind] = _Repeats(now_s + REPEATS_WINDOW_S, record)
            return False
        repeats.more += 1
        repeats.latest = record
        return True

    def _gathered(self) -> list[logging.LogRecord]:
        held, legs = self._held, self._legs
        self._held, self._legs = [], []
        if not legs:
            return held
        also = f"leg{'s' if len(legs) > 1 else ''} {', '.join(map(str, legs))}"
        first = _changed(held[0], f"{held[0].getMessage()}; so {'are' if len(legs) > 1 else 'is'} {also}")
        first.legs = (_silent_leg(held[0]), *legs)
        return [first, *held[1:]]


def _silent_leg(record: logging.LogRecord) -> int | None:
    legs = getattr(record, "legs", None)
    if getattr(record, "kind", None) == Kind.WATCHDOG_EXPIRED and isinstance(legs, tuple | list) and len(legs) == 1:
        return int(legs[0])
    return None


def _counted(repeats: _Repeats) -> logging.LogRecord:
    return _changed(
        repeats.latest, f"{repeats.more} more within {REPEATS_WINDOW_S:g} s, the last: {repeats.latest.getMessage()}"
    )


def _changed(record: logging.LogRecord, message: str) -> logging.LogRecord:
    made = copy.copy(record)
    made.msg, made.args = message, None
    return made
