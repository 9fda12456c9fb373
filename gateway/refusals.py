"""How many refusals are told: ten a second and source, and how many were left out."""

from dataclasses import dataclass
from typing import Final

TOLD_PER_S: Final = 10
SOURCES: Final = 64
"""Sources watched at a time; whoever invents more names shares one allowance with all others that do."""
WINDOW_NS: Final = 1_000_000_000


@dataclass(slots=True)
class _Window:
    begun_ns: int
    told: int = 0
    left_out: int = 0


class RefusalLimit:
    """Says which refusals are told. Time is an argument, memory is bounded."""

    def __init__(self) -> None:
        self._windows: dict[str | None, _Window] = {}

    def admit(self, source: str | None, now_ns: int) -> str | None:
        """What to add to the detail of this refusal ("" or a count of those left out); None: leave it out as well."""
        if source not in self._windows and len(self._windows) >= SOURCES:
            self._forget(now_ns)
            if len(self._windows) >= SOURCES:
                source = None
        window = self._windows.setdefault(source, _Window(now_ns))
        left_out = 0
        if now_ns - window.begun_ns >= WINDOW_NS:
            left_out = window.left_out
            window.begun_ns, window.told, window.left_out = now_ns, 0, 0
        if window.told >= TOLD_PER_S:
            window.left_out += 1
            return None
        window.told += 1
        return f" ({left_out} more from this source were left out)" if left_out else ""

    def _forget(self, now_ns: int) -> None:
        old = [source for source, window in self._windows.items() if now_ns - window.begun_ns >= WINDOW_NS]
        for source in old:
            del self._windows[source]
