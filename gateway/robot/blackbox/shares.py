"""How many records the messages of each source may make, so that a flood does not overwrite what precedes an incident.

All sources together may make as many records a second as the ring has room for (`paths.client_records_a_second`), and
one source SHARE of that: what is left is for others. What is left out is counted by source. Pure.
"""

from dataclasses import dataclass
from typing import Final

from gateway.allowance import NS_PER_S

SHARE: Final = 0.75
"""Of all records that messages may make. In `plain` and in `length-prefixed`, a stream of six legs at the limit makes a
quarter and a half of them."""
SOURCES_COUNTED: Final = 64
"""Sources with a share of their own at a time; all further ones have one together. Sources can be made up."""


@dataclass(slots=True)
class _Share:
    full_ns: int = 0
    """When its share will be whole again."""
    left_out: int = 0


class RecordShares:
    """Admits records. Two token buckets of one second, written out: it is asked for each setpoint."""

    def __init__(self, a_second: int) -> None:
        """`a_second` records at once and a second, of all sources together."""
        self._of_all_ns = NS_PER_S // a_second
        self._of_one_ns = int(NS_PER_S / (a_second * SHARE))
        self._all_full_ns = 0
        self._sources: dict[str | None, _Share] = {}

    def admit(self, source: str | None, count: int, now_ns: int) -> bool:
        """Whether this source's next `count` records are written; if not, they are counted."""
        known = self._sources[source] if source in self._sources else self._known(source, now_ns)
        one_ns, all_ns = known.full_ns, self._all_full_ns
        one_ns = (now_ns if one_ns < now_ns else one_ns) + count * self._of_one_ns
        all_ns = (now_ns if all_ns < now_ns else all_ns) + count * self._of_all_ns
        if one_ns > now_ns + NS_PER_S or all_ns > now_ns + NS_PER_S:
            known.left_out += count
            return False
        known.full_ns, self._all_full_ns = one_ns, all_ns
        return True

    def left_out(self) -> list[tuple[str | None, int]]:
        """Each source of which records were left out since the last call, and how many."""
        found = [(name, each.left_out) for name, each in self._sources.items() if each.left_out]
        for name, _ in found:
            self._sources[name].left_out = 0
        return found

    def _known(self, source: str | None, now_ns: int) -> _Share:
        if len(self._sources) >= SOURCES_COUNTED:
            self._sources = {
                name: each for name, each in self._sources.items() if each.left_out or each.full_ns > now_ns
            }
            if len(self._sources) >= SOURCES_COUNTED:
                source = None
        return self._sources.setdefault(source, _Share())
