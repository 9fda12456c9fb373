"""Chooses which query on a key is read next: queries with a valid token (of the lease or a button) come first.

In a ring in order of arrival, three programs with ten thousand queries a second would push a renewal out; the lease
would expire, or a button count as silent. So the ring is emptied before each read, and valid tokens come first. A few
queries of each token may wait, so that no token displaces another. Sources without a token have a rate limit. A dropped
query gets no answer, and its sender notices.
"""

import re
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Final

import zenoh
from zenoh.handlers import Handler

from gateway.host.worker import Worker
from gateway.rate_limit import RateLimitBySource
from schemas.command import MAX_PAYLOAD_BYTES

TokenCheck = Callable[[str], bool]
"""Returns whether a token is valid. For any thread."""

QUESTIONS_DEPTH: Final = 1024
"""Queries in the ring: 40 000 a second fill it in 25 ms. Each may keep the 64 KiB in which Zenoh received it."""
MOST_OF_TOKEN: Final = 4
"""Waiting queries of one token. A client normally waits for an answer before its next query."""
QUESTIONS_PER_S: Final = 20
"""Questions of a source without a valid token: as many as proofs are checked. Acquiring the lease takes two."""
QUESTIONS_AT_ONCE: Final = 40
"""The same in a burst, such as all pages of a console that reconnect."""
MAX_WITHOUT_TOKEN: Final = 32
"""Waiting queries without a valid token."""
POLL_AGAIN_S: Final = (0.0002, 0.001, 0.004, 0.016, 0.064)
"""Delays of further polls, for a wakeup whose key's ring was empty. Zenoh delivers to the wakeup and to the ring one
after the other, and its thread may be interrupted in between."""
POLL_LATER_S: Final = (*POLL_AGAIN_S, 0.25, 1.0)
"""The same for questions, which nothing else polls."""
POLL_S: Final = 10.0
"""The time between polls without a wakeup. Each wakes an idle processor, which costs more than the poll."""
MOST_WAKES: Final = 64
"""More wakeups wait only in a flood, which goes on waking."""
MOST_ENDING: Final = 4096
"""Dropped queries whose end is not sent yet."""
_TOKEN: Final = re.compile(rb'"(?:lease|button)"\s*:\s*"([0-9a-f]{32})"')


class QuestionRing:
    """A ring of queries, of which those with a valid token are read first. Not thread-safe."""

    def __init__(
        self, ring: Handler[zenoh.Query], knows: TokenCheck, now_ns: Callable[[], int], endings: Worker
    ) -> None:
        """`endings` ends the dropped queries: this blocks while a sender's link is full."""
        self._ring = ring
        self._knows = knows
        self._now_ns = now_ns
        self._first: deque[tuple[str, zenoh.Query]] = deque()
        self._others: deque[zenoh.Query] = deque()
        self._allowance = RateLimitBySource(QUESTIONS_PER_S, QUESTIONS_AT_ONCE)
        self._endings = endings

    def try_recv(self) -> zenoh.Query | None:
        """Return the next query, or None if none waits. Raises ZError once the ring is closed."""
        for _ in range(QUESTIONS_DEPTH):
            query = self._ring.try_recv()
            if query is None:
                break
            if not self._keeps(query) and self._endings.waiting < MOST_ENDING:
                self._endings.do(query.drop)
        if self._first:
            return self._first.popleft()[1]
        return self._others.popleft() if self._others else None

    def _keeps(self, query: zenoh.Query) -> bool:
        """Queue the query. Return False if too many wait, or come from its source."""
        payload, info = query.payload, query.source_info
        read = b"" if payload is None or len(payload) > MAX_PAYLOAD_BYTES else payload.to_bytes()
        found = _TOKEN.search(read)
        if found and self._knows(token := found[1].decode()):
            if sum(each == token for each, _ in self._first) == MOST_OF_TOKEN:
                return False
            self._first.append((token, query))
            return True
        source = None if info is None else str(info.source_id.zid)
        if len(self._others) == MAX_WITHOUT_TOKEN or self._allowance.admit(source, self._now_ns()) is None:
            return False
        self._others.append(query)
        return True


class WokenRing:
    """A ring of queries that one thread waits for, and polls seldom; Zenoh's `recv` wakes ten times a second."""

    def __init__(self, ring: Handler[zenoh.Query] | QuestionRing) -> None:
        self._ring = ring
        self._wakes: SimpleQueue[bool] = SimpleQueue()

    def wake(self) -> None:
        """Report that a query has reached the ring, or will soon. From any thread."""
        if self._wakes.qsize() < MOST_WAKES:
            self._wakes.put(True)

    def close(self) -> None:
        self._wakes.put(False)

    def recv(self) -> zenoh.Query:
        """Return the next query. Blocks until there is one. Raises ZError after `close`."""
        pauses_s: Iterator[float] = iter(())
        while (found := self._ring.try_recv()) is None:
            with suppress(Empty):
                if not self._wakes.get(timeout=next(pauses_s, POLL_S)):
                    raise zenoh.ZError("the ring is closed")
                pauses_s = iter(POLL_LATER_S)
        return found
