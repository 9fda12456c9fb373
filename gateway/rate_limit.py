"""A rate limit with bursts. Pure."""

from math import ceil
from typing import Final

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000


class RateLimit:
    """A token bucket, full at first. `now_ns` is monotonic; constant memory and time."""

    __slots__ = ("_all_ns", "_each_ns", "_full_ns", "left_out")

    def __init__(self, a_second: float, at_once: int) -> None:  # mutants accepted (Step): a clock begins at 0
        """Allow at most `at_once` + T * `a_second` tokens in any T seconds. `a_second` may be a fraction."""
        self._each_ns = ceil(NS_PER_S / a_second)
        self._all_ns = at_once * self._each_ns
        self._full_ns = 0
        self.left_out = 0
        """For `RateLimitBySource`: how many were rejected since the last success."""

    def take(self, now_ns: int, count: int = 1) -> bool:
        """Take `count` tokens. Return False, and take none, if fewer are left."""
        full_ns = max(self._full_ns, now_ns) + count * self._each_ns
        if full_ns > now_ns + self._all_ns:
            return False
        self._full_ns = full_ns
        return True

    def wait_ns(self, now_ns: int) -> int:
        """Return the time in ns until one token is left; 0: now."""
        return max(0, self._full_ns + self._each_ns - self._all_ns - now_ns)

    def is_full(self, now_ns: int) -> bool:
        """Return whether the bucket is full."""
        return self._full_ns <= now_ns


MOST_SOURCES: Final = 64
"""Most sources with an allowance of their own at a time: the limit of sessions."""


class RateLimitBySource:
    """The same allowance for each source. Sources beyond MOST_SOURCES share one, since anybody may claim any name."""

    def __init__(self, a_second: float, at_once: int) -> None:
        self._each = a_second, at_once
        self._known: dict[str | None, RateLimit] = {}

    def admit(self, source: str | None, now_ns: int, count: int = 1) -> int | None:
        """Take `count` tokens of this source. Return how many were rejected since the last success; None: rejected."""
        known = self._known.get(source) or self._begun(source, now_ns)
        if not known.take(now_ns, count):
            known.left_out += count
            return None
        left_out, known.left_out = known.left_out, 0
        return left_out

    def _begun(self, source: str | None, now_ns: int) -> RateLimit:
        """Return the allowance of a source that has none yet."""
        if len(self._known) >= MOST_SOURCES:
            self._known = {name: known for name, known in self._known.items() if not known.is_full(now_ns)}
            if len(self._known) >= MOST_SOURCES:
                source = None
        return self._known.setdefault(source, RateLimit(*self._each))
