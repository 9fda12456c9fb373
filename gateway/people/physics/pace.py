"""Real time: how many steps are due, and how far behind a machine is that cannot keep up. Pure: time is an argument."""

from typing import Final

MOST_BEHIND_S: Final = 0.1
"""What is missing beyond this is left out: the body is slower then, and does not leap afterwards."""
WINDOW_S: Final = 2.0
"""Over so long the factor is measured."""
SLOW: Final = 0.95
"""Below this factor a person is informed, and again above `KEEPS_UP`."""
KEEPS_UP: Final = 0.99


class Pace:
    """Times are seconds of one monotonic clock."""

    def __init__(self, timestep_s: float, now_s: float) -> None:
        self._timestep_s = timestep_s
        self._next_s = now_s
        self._begun_s = now_s
        self._steps = 0
        self._is_slow = False
        self.factor = 1.0
        """Simulated seconds in a second of the latest window."""

    def due(self, now_s: float) -> int:
        """How many steps to simulate now."""
        self._next_s = max(self._next_s, now_s - MOST_BEHIND_S)
        steps = max(0, int((now_s - self._next_s) / self._timestep_s))
        self._next_s += steps * self._timestep_s
        self._steps += steps
        return steps

    def report(self, now_s: float) -> str | None:
        """At the end of a window in which the machine became too slow, or fast enough again: a sentence."""
        length_s = now_s - self._begun_s
        if length_s < WINDOW_S:
            return None
        self.factor = min(1.0, self._steps * self._timestep_s / length_s)
        self._begun_s, self._steps = now_s, 0
        if not self._is_slow and self.factor < SLOW:
            self._is_slow = True
            return (
                f"this machine simulates {self.factor:.2f} s of each second: the body moves more slowly than it would; "
                "the gateway is not delayed"
            )
        if self._is_slow and self.factor >= KEEPS_UP:
            self._is_slow = False
            return "this machine simulates the body in real time again"
        return None
