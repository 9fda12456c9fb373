"""Latencies: percentiles of the last ones, a histogram of all, and the worst.

They are apart from the other metrics, since `stop-servos` uses them and must load fast.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from typing import Final

BOUNDS_US: Final = (50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 500_000)
"""Upper ends of the histogram's buckets, from one transfer (45 µs) to a delay that is visible on the robot."""


@dataclass(slots=True)
class Latency:
    """Latencies in microseconds: the last ones for percentiles, all of them as a histogram, and the worst."""

    recent_us: deque[float] = field(default_factory=lambda: deque(maxlen=1000))
    buckets: list[int] = field(default_factory=lambda: [0] * (len(BOUNDS_US) + 1))
    sum_us: float = 0.0
    max_us: float | None = None

    def record(self, latency_ns: int) -> None:
        latency_us = latency_ns / 1000
        self.recent_us.append(latency_us)
        self.buckets[bisect_left(BOUNDS_US, latency_us)] += 1
        self.sum_us += latency_us
        if self.max_us is None or latency_us > self.max_us:
            self.max_us = latency_us

    def p50_p99_us(self) -> tuple[float, float] | tuple[None, None]:
        """Return the percentiles 50 and 99 of the last latencies (µs); None before the first."""
        if not self.recent_us:
            return None, None
        ordered, count = sorted(self.recent_us), len(self.recent_us)
        return ordered[-(-count // 2) - 1], ordered[-(-99 * count // 100) - 1]

    def at_most_us(self, share: float) -> float | None:
        """Return a bound (µs) that `share` of all did not exceed: a bucket's end or the worst. Coarse, but fast."""
        left = share * sum(self.buckets)
        for bound_us, count in zip(BOUNDS_US, self.buckets, strict=False):
            left -= count
            if left <= 0 and self.max_us is not None:
                return min(float(bound_us), self.max_us)
        return self.max_us
