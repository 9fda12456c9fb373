"""Which question on a key is read next: that of the driver, or of a button that checks in, before everybody else's.

Such a question carries a token that is good. If it waited in one ring with all others, three programs that ask ten
thousand times a second would push it out, and the lease would expire, or the button fall silent. So the ring is emptied
each time that a question is wanted, and those with a good token go first: of each token a few may wait, so that none
keeps another out. Of all others, each source has so many a second. What is let go has no answer, which its sender
notices.
"""

import re
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, Generic, TypeVar

import zenoh
from zenoh.handlers import Handler

from gateway.allowance import Allowance
from gateway.robot.host.worker import Worker
from schemas.command import MAX_PAYLOAD_BYTES

Knows = Callable[[str], bool]
"""Whether a token is good. From any thread."""
Item = TypeVar("Item")

DEPTH: Final = 1024
"""Questions that wait in the ring: 40 000 a second fill it in 25 ms. More would cost memory: while this thread waits, a
question may keep the 64 KiB that Zenoh received it in."""
MOST_OF_TOKEN: Final = 4
"""That wait to be read; their sender waits for the answer before the next one, as a rule."""
PER_S: Final = 20
"""Of each source without a good token: no more proofs are checked, and to drive takes two questions."""
AT_ONCE: Final = 40
"""The same without a pause: the pages of a console that all come back."""
MOST_SOURCES: Final = 64
"""As many as there may be sessions. Further ones share one place: a source is only what somebody writes."""
MOST_WAITING: Final = 32
"""Of those without a good token."""
MOST_ENDING: Final = 4096
"""Whose end has not been sent yet."""
_TOKEN: Final = re.compile(rb'"(?:lease|button)"\s*:\s*"([0-9a-f]{32})"')


class Questions(Generic[Item]):
    """Those on one key that wait to be read. Pure: the time is an argument."""

    def __init__(self, knows: Knows) -> None:
        self._knows = knows
        self._first: deque[tuple[str, Item]] = deque()
        self._of_token: Counter[str] = Counter()
        self._others: deque[Item] = deque()
        self._allowances: dict[str | None, Allowance] = {}
        """Of each source; None: of all further ones."""

    def add(self, item: Item, payload: bytes, source: str | None, now_ns: int) -> bool:
        """Whether this question will be read; else it is to be let go."""
        found = _TOKEN.search(payload)
        token = None if found is None else found[1].decode()
        if token is not None and self._knows(token):
            if self._of_token[token] == MOST_OF_TOKEN:
                return False
            self._of_token[token] += 1
            self._first.append((token, item))
            return True
        if len(self._others) == MOST_WAITING or not self._is_admitted(source, now_ns):
            return False
        self._others.append(item)
        return True

    def next(self) -> Item | None:
        """The one that is read next."""
        if not self._first:
            return self._others.popleft() if self._others else None
        token, item = self._first.popleft()
        self._of_token[token] -= 1
        if not self._of_token[token]:
            del self._of_token[token]
        return item

    def _is_admitted(self, source: str | None, now_ns: int) -> bool:
        if source not in self._allowances and len(self._allowances) >= MOST_SOURCES:
            self._allowances = {each: used for each, used in self._allowances.items() if not used.is_full(now_ns)}
            if len(self._allowances) >= MOST_SOURCES:
                source = None
        return self._allowances.setdefault(source, Allowance(PER_S, AT_ONCE)).take(now_ns)


class QuestionRing:
    """A ring of queries that gives them in that order. For one thread."""

    def __init__(self, ring: Handler[zenoh.Query], knows: Knows, now_ns: Callable[[], int]) -> None:
        self._ring = ring
        self._now_ns = now_ns
        self._questions: Questions[zenoh.Query] = Questions(knows)
        self._endings = Worker("end questions", priority=None)

    def recv(self) -> zenoh.Query:
        """The next one. Waits for it; raises ZError once the ring is closed."""
        while True:
            for _ in range(DEPTH):
                item = self._ring.try_recv()
                if item is None:
                    break
                self._sort(item)
            found = self._questions.next()
            if found is not None:
                return found
            self._sort(self._ring.recv())

    def close(self) -> None:
        """End the thread of its own, once the ring is closed. Blocks."""
        self._endings.close()

    def _sort(self, query: zenoh.Query) -> None:
        payload, info = query.payload, query.source_info
        read = b"" if payload is None or len(payload) > MAX_PAYLOAD_BYTES else payload.to_bytes()
        source = None if info is None else str(info.source_id.zid)
        if not self._questions.add(query, read, source, self._now_ns()) and self._endings.waiting < MOST_ENDING:
            # Its asker's link may be full, and the end then waits: not here, where others' questions are read.
            self._endings.do(query.drop)
