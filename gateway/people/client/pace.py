"""Decides when a stream sends, asks the gateway, and warns. Pure: `now_s` never goes back."""

import math
from collections import deque
from collections.abc import Iterable
from typing import Final, NamedTuple

SILENCE_S: Final = 0.5
"""After this time without a report the gateway is asked. By default a state is published every 0.1 s."""
LATE_PART: Final = 0.5
"""The part of a period after which a late setpoint waits for the next tick, to keep a distance between two."""
MOST_DEG: Final = 3.2
"""Half a turn in radians, rounded up."""
MOST_QUESTIONS: Final = 2
"""Questions a second while the robot is stopped or the gateway does not answer."""
_KEPT_TICKS: Final = 1000
"""The ticks kept for the jitter: 20 s at 50 Hz."""
LIKE_RADIANS: Final = 'angles are degrees, 0 to 180, and these look like radians (`unit="rad"` takes them)'


class Jitter(NamedTuple):
    """The delays of the newest 1000 setpoints after their ticks, in milliseconds."""

    p50_ms: float
    p99_ms: float
    max_ms: float


class SetpointPace:
    """When setpoints are due: a grid of ticks without drift. A missed tick is skipped, never sent later. Pure.

    >>> pace = SetpointPace(50)
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
        """Ticks without a setpoint in time."""
        self._begun_s: float | None = None
        self._tick: int
        self._last_s = -math.inf
        self._late_s: deque[float] = deque(maxlen=_KEPT_TICKS)

    def begin(self, now_s: float) -> None:
        """Begin the grid with a setpoint that is sent now."""
        self._begun_s = self._last_s = now_s
        self._tick = 0

    def pause(self) -> None:
        """Count no tick as missed until the next `begin`."""
        self._begun_s = None

    def next_s(self, now_s: float, least_s: float = -math.inf) -> float:
        """Return when to send a setpoint that is ready now, `least_s` at the earliest. Call it once for each."""
        if self._begun_s is None:
            self._last_s = max(now_s, self._last_s + self.period_s, least_s)
        else:
            late = (now_s - self._begun_s) / self.period_s - (self._tick + 1)
            skipped = max(0, math.ceil(late - LATE_PART))
            self.missed += skipped
            self._tick += 1 + skipped
            self._last_s = self._begun_s + self._tick * self.period_s
        return self._last_s

    def sent(self, now_s: float) -> None:
        """Record that the setpoint of the newest `next_s` was sent."""
        self._late_s.append(now_s - self._last_s)

    @property
    def jitter(self) -> Jitter:
        """The delays of setpoints; all 0 before the first."""
        late_s = sorted(self._late_s) or [0.0]
        return Jitter(*(round(1000 * late_s[int(part * (len(late_s) - 1))], 3) for part in (0.5, 0.99, 1)))


class Retries:
    """When a stopped or unanswered program may ask again: at most MOST_QUESTIONS times in a second. Pure.

    >>> retries = Retries()
    >>> for now_s in (10.0, 10.1):     # the question that found it stopped, and a start: that one need not wait
    ...     retries.next_s
    ...     retries.asked(now_s)
    -inf
    -inf
    >>> retries.next_s
    11.0
    """

    def __init__(self) -> None:
        self._asked_s: deque[float] = deque(maxlen=MOST_QUESTIONS)

    def asked(self, now_s: float) -> None:
        """Record a question that found the robot stopped, or had no answer."""
        self._asked_s.append(now_s)

    def succeeded(self) -> None:
        """Record that legs have started."""
        self._asked_s.clear()

    @property
    def next_s(self) -> float:
        """When the next question may be asked."""
        if len(self._asked_s) < MOST_QUESTIONS:
            return -math.inf
        return max(self._asked_s[0] + 1, self._asked_s[-1] + 1 / MOST_QUESTIONS)


class Doubt:
    """When a stream asks the gateway whether its legs run, before it sends more. Pure.

    >>> doubt = Doubt(watchdog_s=0.25)
    >>> doubt.sent(10.0)
    >>> doubt.received(10.0)
    >>> [doubt.is_there(now_s) for now_s in (10.2, 10.25)]    # by then the watchdog may have stopped the legs
    [False, True]
    """

    def __init__(self, watchdog_s: float) -> None:
        """`watchdog_s`: the time without a setpoint after which the gateway stops a leg."""
        self.watchdog_s = watchdog_s
        self._sent_s = self._received_s = -math.inf
        self._raised = False

    def sent(self, now_s: float) -> None:
        self._sent_s = now_s

    def received(self, now_s: float) -> None:
        """Record that the gateway has published something, or answered."""
        self._received_s = now_s

    def raise_it(self) -> None:
        """Record a report that only the gateway's answer can confirm."""
        self._raised = True

    def asked(self) -> None:
        """Record that the gateway is asked now. Later reports raise a new doubt."""
        self._raised = False

    def is_there(self, now_s: float) -> bool:
        """Return whether to ask the gateway: a doubt was raised, this program stalled, or the gateway is silent."""
        stalled = now_s - self._sent_s >= self.watchdog_s
        return self._raised or stalled or now_s - self._received_s >= SILENCE_S


def thins(hz: float, limit_hz: float) -> str | None:
    """Return the warning if the gateway leaves out some of a stream's setpoints, or None. Pure.

    >>> thins(50, 50), thins(20, 50)
    (None, None)
    >>> thins(100, 50)
    'the gateway takes 50 setpoints a second for each leg (limits.leg_rate_hz): of 100 Hz it leaves out 50 %'
    """
    if hz <= limit_hz:
        return None
    left_out = 100 * (1 - limit_hz / hz)
    return (
        f"the gateway takes {limit_hz:g} setpoints a second for each leg (limits.leg_rate_hz): "
        f"of {hz:g} Hz it leaves out {left_out:.0f} %"
    )


def like_radians(angles_deg: Iterable[float]) -> bool:
    """Return whether angles look like radians, which are all legal in degrees, but hardly move the robot. Pure.

    >>> like_radians((1.57, 0.8, 2.1)), like_radians((90, 0.8, 2.1)), like_radians((0, 0, 0))
    (True, False, False)
    """
    angles = list(angles_deg)
    return max(angles, default=math.inf) <= MOST_DEG and any(each % 1 for each in angles)
