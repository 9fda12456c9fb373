"""The order in which rings are read, so that no older Start overtakes a newer Stop. Pure: no Zenoh, no clock.

Zenoh delivers the messages of one session in order, each into its key's ring. Once a Stop is taken from a ring, every
older message of its session has been taken or waits in its own ring. Therefore all rings with commands for the same
servos (`core/intake.py`) are read again, until nothing new is found. All messages found are one instant, in which a
Stop wins over a Start or Set of another ring (supervisor).

After a Start or Set, only the rings whose commands apply earlier are read again (`legs` before `leg` before `servo`):
an older command there must not apply later. Commands in the other rings apply later, in this instant or another.

During a flood of several keys this would never end, so the passes are limited. If rings are left after the last pass,
and a Stop may have been taken, the instant stays open: the next `read` still belongs to it. Setpoints alone close it:
otherwise a stopped servo could not be started again while setpoints keep arriving.

A ring keeps its newest messages, so a flood of one key pushes out a Stop on that key. A full ring is reported to the
reader: a Stop may have been lost. (A `get` that is pushed out gets no answer, and its sender notices.) A stream that
was delayed and arrives at once is no flood: a ring of puts has room for it (`put_depth`). Only the newest few messages
are processed, and those of the older ones that may be Stops.
"""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Final, Generic, TypeVar

from gateway.robot.core.intake import follows, servos_of
from schemas.keys import COMMAND_KEYS

RING_DEPTH: Final = 8
"""Messages per ring and tick: enough for a start, a stop and some setpoints sent at once. Further ones are older."""
STREAM_RATES: Final = 4
"""A stream at up to this multiple of `limits.leg_rate_hz` loses nothing if it is delayed by the watchdog's timeout."""
LEAST_PUT_DEPTH: Final = 16
MAX_PUT_DEPTH: Final = 1024
"""Puts of a key that are kept at most, as for 1000 Hz and a watchdog of 0.25 s; by default 58 are. More would take
time: in a flood of 600 000 messages a second, 16 reads of a ring took 0.02 ms (p99 0.07), 64 took 0.06 ms (p99 0.4).
And memory: while the loop is delayed, a message may keep the 64 KiB in which Zenoh received it."""
PASSES: Final = 4  # mutants accepted (Step): none is the only right one
"""Reads of the rings for one instant, at most. Without a flood the second pass finds nothing."""

Item = TypeVar("Item")
"""A sample or query of Zenoh."""
Message = TypeVar("Message")
"""The message made from it."""
Receive = Callable[[], Item | None]
"""Takes a ring's oldest message; None: the ring is empty."""
WordsOfStop = Callable[[Message], bytes | None]
"""Returns the words of a message that may be a Stop, else None. It misses no Stop, but may take others for one."""


def put_depth(leg_rate_hz: float, timeout_ms: float) -> int:
    """Return how many puts of a key are kept: a stream's during the watchdog's timeout, and some before them."""
    held_back = math.ceil(STREAM_RATES * leg_rate_hz * timeout_ms / 1000)
    return min(max(held_back + RING_DEPTH, LEAST_PUT_DEPTH), MAX_PUT_DEPTH)


@dataclass(eq=False, slots=True)
class Ring(Generic[Item]):
    """The messages of one key and kind (`put` and `delete`, or `get`), in their order of arrival."""

    key: str
    receive: Receive[Item]
    depth: int
    servos: frozenset[int]
    """The servos that its messages may stop. A ring of resets has none and contains no Stop."""
    place: int = 0
    """The position of its commands in an instant."""
    others: "frozenset[Ring[Item]]" = frozenset()
    """The rings to read again after a Stop from this one, since they may contain an older message."""
    before: "frozenset[Ring[Item]]" = frozenset()
    """Those of `others` whose commands apply earlier. They are read again after every message from this ring."""


class Rings(Generic[Item, Message]):
    """All rings of commands.

    `receivers` has two for each key: `put` (of `depth`) and `get` (of RING_DEPTH). Its order is that of an instant.
    """

    def __init__(
        self,
        receivers: Mapping[str, tuple[Receive[Item], Receive[Item]]],
        make: Callable[[str, Item], Message],
        words_of_stop: WordsOfStop[Message],
        depth: int = LEAST_PUT_DEPTH,
    ):
        self._make = make
        self._words_of_stop = words_of_stop
        self._of: dict[str, list[Ring[Item]]] = {}
        for key, (put, get) in receivers.items():
            servos = servos_of(COMMAND_KEYS[key])
            self._of[key] = [Ring(key, put, depth, servos), Ring(key, get, RING_DEPTH, servos)]
        self._all = list(chain(*self._of.values()))
        for place, ring in enumerate(self._all):
            behind = follows(COMMAND_KEYS[ring.key])
            ring.place = place
            ring.others = frozenset(each for each in self._all if each is not ring and behind & each.servos)
            ring.before = ring.others.intersection(self._all[:place])
        self.instant_open = False
        """Whether the next `read` belongs to the same instant as the last."""
        self.passed_over = 0
        """Messages that newer ones of their key displaced: taken from a ring, and not returned."""

    # mutants accepted (BreakWithContinue, Step): what is left changes nothing
    def read(self, keys: Collection[str] = ()) -> list[tuple[str, Message | None]]:
        """Return the keys and messages in the rings of `keys` (default: all) and of the rings read again with them.

        The order is `legs`, `leg`, `servo`, resets, and within a ring its own. A message None means that a Stop may
        have been lost before the next messages of its key.
        """
        due: Collection[Ring[Item]] = self._all
        if keys and not self.instant_open:
            due = [ring for key in keys for ring in self._of[key]]
        taken: list[tuple[Ring[Item], list[Message | None]]] = []
        stops = False
        for _ in range(PASSES):
            again: set[Ring[Item]] = set()
            for ring in due:
                if again:
                    again.discard(ring)  # it is read now, after the message that made it due
                first = ring.receive()
                if first is not None:
                    second = ring.receive()
                    items: list[Message | None]
                    items = [self._make(ring.key, first)] if second is None else self._taken(ring, [first, second])
                    taken += [(ring, items)]
                    older = ring.before
                    for item in items if ring.servos else ():
                        if item is None or self._words_of_stop(item) is not None:
                            stops, older = True, ring.others
                            break
                    again |= older
            due = again
            if not due:
                break
        self.instant_open = bool(due) and stops
        if taken[1:]:
            taken.sort(key=lambda each: each[0].place)
        return [(ring.key, item) for ring, items in taken for item in items]

    def _taken(self, ring: Ring[Item], found: list[Item]) -> list[Message | None]:
        """Take the messages after `found`, up to the ring's depth. Further ones wait for the next read.

        Return the newest messages, after the older Stops, or after None if some may have been lost.
        """
        while len(found) < ring.depth and (more := ring.receive()) is not None:
            found.append(more)
        newest: list[Message | None] = [self._make(ring.key, item) for item in found[-RING_DEPTH:]]
        if len(found) == ring.depth > RING_DEPTH and ring.servos:
            return [None, *newest]  # the older ones count as lost
        self.passed_over += len(found) - len(newest)
        if len(found) <= RING_DEPTH or not ring.servos:
            return newest
        stops: dict[bytes, Message] = {}
        for item in found[:-RING_DEPTH]:
            older = self._make(ring.key, item)
            words = self._words_of_stop(older)
            if words is not None:
                stops.pop(words, None)  # only the last of equal Stops, so that a flood of Stops takes no time
                stops[words] = older
        self.passed_over -= len(stops)
        return [*stops.values(), *newest]
