"""A rate limit with bursts. Pure."""

from math import ceil
from typing import Final

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000


class Allowance:
    """A token bucket, full at first. `now_ns` is monotonic; constant memory and time."""

    __slots__ = ("_all_ns", "_each_ns", "_full_ns")

    def __init__(self, a_second: float, at_once: int) -> None:
        """At most `at_once` + T * `a_second` are taken in any T seconds. `a_second` may be a fraction."""
        self._each_ns = ceil(NS_PER_S / a_second)
        self._all_ns = at_once * self._each_ns
        self._full_ns = 0

    def take(self, now_ns: int, count: int = 1) -> bool:
        """Take `count` tokens; False: fewer are left, and none is taken."""
        full_ns = max(self._full_ns, now_ns) + count * self._each_ns
        if full_ns > now_ns + self._all_ns:
            return False
        self._full_ns = full_ns
        return True

    def wait_ns(self, now_ns: int) -> int:
        """Time until one token may be taken."""
        return max(0, self._full_ns + self._each_ns - self._all_ns - now_ns)

    def is_full(self, now_ns: int) -> bool:
        """Whether the bucket is full."""
        return self._full_ns <= now_ns
