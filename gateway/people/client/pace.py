"""When setpoints are due: a grid of ticks that does not drift."""

import math
from typing import Final

LATE: Final = 0.5
"""Of a period. What comes later than that after its tick waits for the next: no two setpoints are closer."""


class Pace:
    """Says when the next setpoint is due. A missed tick is skipped and counted, never made up. Pure.

    >>> pace = Pace(50)
    >>> pace.begin(10.0)
    >>> round(pace.next_s(10.001), 3)       # early: at the next tick
    10.02
    >>> round(pace.next_s(10.075), 3)       # ticks at .04 and .06 are over; the one at .08 is next
    10.08
    >>> pace.missed
    2
    """

    def __init__(self, hz: float) -> None:
        self.period_s = 1 / hz
        self.missed = 0
        """Ticks for which no setpoint came in time."""
        self._begun_s: float | None = None
        self._tick = 0

    def begin(self, now_s: float) -> None:
        """A setpoint was sent now; the grid begins with it."""
        self._begun_s = now_s
        self._tick = 0

    def pause(self) -> None:
        """Until the next `begin` nothing is due, and nothing missed."""
        self._begun_s = None

    def next_s(self, now_s: float) -> float:
        """When a setpoint that is there now is due, once for each."""
        if self._begun_s is None:
            return now_s
        late = (now_s - self._begun_s) / self.period_s - (self._tick + 1)
        skipped = max(0, math.ceil(late - LATE))
        self.missed += skipped
        self._tick += 1 + skipped
        return self._begun_s + self._tick * self.period_s
