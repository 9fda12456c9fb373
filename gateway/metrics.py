"""Counters and latencies of one service."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from schemas.telemetry import StopLatency

KEPT: Final = 1000
"""Latencies kept for the percentiles: the last thousand Stops."""


def percentile(ordered: Sequence[float], share: float) -> float:
    """The smallest value that at least `share` of the (sorted, non-empty) values do not exceed."""
    return ordered[max(0, -(-int(share * 1000) * len(ordered) // 1000) - 1)]


@dataclass(slots=True)
class Latency:
    """Latencies in microseconds: the last ones for percentiles, the worst of all."""

    recent_us: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    max_us: float | None = None

    def record(self, latency_ns: int) -> None:
        """Take one latency."""
        latency_us = latency_ns / 1000
        self.recent_us.append(latency_us)
        self.max_us = latency_us if self.max_us is None else max(self.max_us, latency_us)

    def report(self) -> StopLatency:
        """p50, p99 and worst, or nulls before the first."""
        if self.max_us is None:
            return StopLatency(p50=None, p99=None, max=None)
        ordered = sorted(self.recent_us)
        return StopLatency(p50=percentile(ordered, 0.5), p99=percentile(ordered, 0.99), max=self.max_us)


@dataclass(slots=True)
class Metrics:
    """What the service counts."""

    accepted: int = 0
    rejected: int = 0
    coalesced: int = 0
    watchdog_stops: Latency = field(default_factory=Latency)
