"""Which commands were held up on their way (`limits.max_age_ms`), without synchronised clocks. Pure.

A command may carry `sent_ms`, its publisher's own monotonic clock. That clock's zero is unknown, so (arrival - sent_ms)
is the time on the way plus an unknown constant. The smallest such difference that a source has shown is taken as the
way without delay, the *baseline*; what a command's own difference has more than that is how long it was held up.

- After a stall, the queued commands come in a burst, each with its own delay on top: refused until the first fresh one.
  The baseline is not forgotten in a silence, however long, for after it comes the burst.
- A clock that drifts moves the baseline: it rises by 200 ppm, twice what a bad crystal does, and falls at once.
- A publisher that restarts has a clock that jumps back. Commands of one source arrive in the order in which they were
  sent, save for those of one instant and small overtakings, so one that was sent a second or more *before* an earlier
  one comes from a new clock: its difference is the new baseline.
- A clock may also fall behind without jumping back (the laptop slept; a restart within its first second), or the way
  may have become longer for good. Then commands keep coming with a steady delay, which a queue being emptied never
  shows: after five seconds of that, the steady delay is the new baseline.
"""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

SOURCES: Final = 64
"""Sources remembered; beyond, the one not heard for longest is forgotten, and learned anew from its next command."""
DRIFT: Final = 200e-6
JUMP_BACK_MS: Final = 1000.0
STEADY_MS: Final = 5000.0
GAP_MS: Final = 1000.0
"""A pause in the arrivals longer than this ends a steady stretch: what comes after it may be another burst."""


@dataclass(slots=True)
class _Stretch:
    """Late commands in a row: when they began to come, when the last one came, and their differences' range."""

    begun_ms: float
    last_ms: float
    smallest_ms: float
    largest_ms: float


@dataclass(slots=True)
class _Source:
    baseline_ms: float
    heard_ms: float
    newest_sent_ms: float
    newest_before_ms: float
    stretch: _Stretch | None = None


class Staleness:
    """How long each source's commands were held up."""

    def __init__(self, max_age_ms: float) -> None:
        self._max_age_ms = max_age_ms
        self._sources: OrderedDict[str | None, _Source] = OrderedDict()

    def held_up_ms(self, name: str | None, sent_ms: float, now_ns: int) -> float | None:
        """Take one command; how long it was held up, where that is more than the settings allow, else None."""
        now_ms = now_ns / 1e6
        source = self._sources.get(name)
        if source is None:
            self._sources[name] = _Source(now_ms - sent_ms, now_ms, sent_ms, sent_ms)
            if len(self._sources) > SOURCES:
                self._sources.popitem(last=False)
            return None
        self._sources.move_to_end(name)
        late_ms = self._late_ms(source, sent_ms, now_ms)
        if late_ms <= self._max_age_ms:
            source.stretch = None
            return None
        if self._is_steady(source, now_ms - sent_ms, now_ms):
            source.baseline_ms, source.stretch = now_ms - sent_ms, None
            return None
        return late_ms

    def _late_ms(self, source: _Source, sent_ms: float, now_ms: float) -> float:
        if now_ms > source.heard_ms:
            source.baseline_ms += DRIFT * (now_ms - source.heard_ms)
            source.heard_ms, source.newest_before_ms = now_ms, source.newest_sent_ms
        difference_ms = now_ms - sent_ms
        if sent_ms < source.newest_before_ms - JUMP_BACK_MS:
            source.baseline_ms, source.newest_sent_ms, source.newest_before_ms = difference_ms, sent_ms, sent_ms
        source.newest_sent_ms = max(source.newest_sent_ms, sent_ms)
        source.baseline_ms = min(source.baseline_ms, difference_ms)
        return difference_ms - source.baseline_ms

    def _is_steady(self, source: _Source, difference_ms: float, now_ms: float) -> bool:
        stretch = source.stretch
        if stretch is None or now_ms - stretch.last_ms > GAP_MS:
            source.stretch = _Stretch(now_ms, now_ms, difference_ms, difference_ms)
            return False
        stretch.last_ms = now_ms
        stretch.smallest_ms = min(stretch.smallest_ms, difference_ms)
        stretch.largest_ms = max(stretch.largest_ms, difference_ms)
        if stretch.largest_ms - stretch.smallest_ms > self._max_age_ms:
            source.stretch = _Stretch(now_ms, now_ms, difference_ms, difference_ms)
            return False
        return now_ms - stretch.begun_ms >= STEADY_MS
