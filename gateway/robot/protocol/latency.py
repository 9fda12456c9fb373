"""Latencies: percentiles of the last ones, a histogram of all, and the worst.

They are apart from the other metrics, since `stop-servos` uses them and must load fast.
"""

from bisect import bisect_left
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

BOUNDS_US: Final = (50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 500_000)
"""Upper ends of the histogram's buckets, from one transfer (45 µs) to a delay that is visible on the robot."""


NEW: Final = 64
"""How many latencies are kept until they are counted: with cold caches, counting one by one takes twice the time."""


@dataclass(slots=True)
class Latency:
    """Latencies in microseconds: the last ones for percentiles, all of them as a histogram, and the worst."""

    _new_ns: deque[int] = field(default_factory=deque)
    _recent_us: deque[float] = field(default_factory=lambda: deque(maxlen=1000))
    _buckets: list[int] = field(default_factory=lambda: [0] * (len(BOUNDS_US) + 1))
    _sum_us: float = 0.0
    _max_us: float | None = None

    def record(self, latency_ns: int) -> None:
        new_ns = self._new_ns
        new_ns.append(latency_ns)
        if len(new_ns) >= NEW:
            self._count()

    def _count(self) -> None:
        new_us: list[float] = []
        with suppress(IndexError):  # none is left. One by one: the page of metrics counts on a thread of its own
            while True:
                new_us.append(self._new_ns.popleft() / 1000)
        for latency_us in new_us:
            self._buckets[bisect_left(BOUNDS_US, latency_us)] += 1
        self._recent_us += new_us
        new_sum_us = sum(new_us)  # first: a call between reading and writing loses the other thread's sum
        self._sum_us += new_sum_us
        self._max_us = max([*new_us, self._max_us or 0.0]) if new_us else self._max_us

    @property
    def recent_us(self) -> deque[float]:
        self._count()
        return self._recent_us

    @property
    def buckets(self) -> list[int]:
        self._count()
        return self._buckets

    @property
    def sum_us(self) -> float:
        self._count()
        return self._sum_us

    @property
    def max_us(self) -> float | None:
        self._count()
        return self._max_us

    def p50_p99_us(self) -> tuple[float, float] | tuple[None, None]:
        """Return the percentiles 50 and 99 of the last latencies (µs); None before the first."""
        ordered = sorted(self.recent_us)
        count = len(ordered)
        if not ordered:
            return None, None
        return ordered[-(-count // 2) - 1], ordered[-(-99 * count // 100) - 1]

    def at_most_us(self, share: float) -> float | None:
        """Return a bound (µs) that `share` of all did not exceed: a bucket's end or the worst. Coarse, but fast."""
        buckets, max_us = self.buckets, self.max_us
        left = share * sum(buckets)
        for bound_us, count in zip(BOUNDS_US, buckets, strict=False):
            left -= count
            if left <= 0 and max_us is not None:
                return min(float(bound_us), max_us)
        return max_us
