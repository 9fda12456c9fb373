"""Publishers whose commands may be delayed on their way to `Staleness`."""

import re

from gateway.model.staleness import Staleness

MAX_AGE_MS = 200.0
MS = 1_000_000


class Publisher:
    """Publishes by a clock of its own: an unknown zero, and perhaps another rate."""

    def __init__(
        self, staleness: Staleness, *, name: str | None = "laptop", zero_ms: float = 5e6, ppm: float = 0
    ) -> None:
        self._staleness, self.name, self.zero_ms, self._rate = staleness, name, zero_ms, 1 + ppm * 1e-6

    def clock_ms(self, now_ms: float) -> float:
        return self.zero_ms + now_ms * self._rate

    def arrives(self, now_ms: float, *, sent_at_ms: float | None = None) -> float | None:
        """A command that arrives now, sent now or earlier; how long it was delayed, if it is rejected for that."""
        said = self.asks(now_ms, sent_at_ms=sent_at_ms)
        if said is None:
            return None
        delayed = re.fullmatch(r"the command was delayed for (\d+) ms; at most 200 are allowed", said)
        assert delayed, said
        return float(delayed[1])

    def asks(self, now_ms: float, *, sent_at_ms: float | None = None) -> str | None:
        """The same; why it is rejected."""
        sent_ms = self.clock_ms(now_ms if sent_at_ms is None else sent_at_ms)
        return self._staleness.too_old(self.name, sent_ms, round(now_ms * MS), round(now_ms * MS))

    def streams(self, begin_ms: float, end_ms: float, *, delay_ms: float = 0.0, period_ms: float = 20.0) -> list[bool]:
        """Whether each command of a stream is rejected."""
        count = int((end_ms - begin_ms) / period_ms)
        times = [begin_ms + index * period_ms for index in range(count)]
        return [self.arrives(sent_ms + delay_ms, sent_at_ms=sent_ms) is not None for sent_ms in times]


class NeverStopped(Staleness):
    """The loop turned all the time, also between the commands of a test."""

    def record_alive(self, now_ns: int) -> None:
        """Nothing to notice."""
