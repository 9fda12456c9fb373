"""Limits how many rejections are published as events: ten a second and source; counts those left out."""

from collections import deque
from dataclasses import dataclass, field
from typing import Final

TOLD_PER_S: Final = 10
SOURCES: Final = 64
"""Sources counted separately at a time; all further ones share one allowance."""
WINDOW_NS: Final = 1_000_000_000


@dataclass(slots=True)
class _Source:
    told_ns: deque[int] = field(default_factory=lambda: deque(maxlen=TOLD_PER_S))
    left_out: int = 0


class RejectionLimit:
    """Decides which rejections are published: at most ten of a source in any second. Memory is bounded."""

    def __init__(self) -> None:
        self._sources: dict[str | None, _Source] = {}

    def admit(self, source: str | None, now_ns: int) -> int | None:
        """How many of this source were left out before this one, which is published; None: leave this one out, too."""
        if source not in self._sources and len(self._sources) >= SOURCES:
            self._forget(now_ns)
            if len(self._sources) >= SOURCES:
                source = None
        known = self._sources.setdefault(source, _Source())
        if len(known.told_ns) == TOLD_PER_S and now_ns - known.told_ns[0] < WINDOW_NS:
            known.left_out += 1
            return None
        known.told_ns.append(now_ns)
        left_out, known.left_out = known.left_out, 0
        return left_out

    def _forget(self, now_ns: int) -> None:
        old = [source for source, known in self._sources.items() if now_ns - known.told_ns[-1] >= WINDOW_NS]
        for source in old:
            del self._sources[source]
