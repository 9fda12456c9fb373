"""The order in which rings are read, so that no older Start overtakes a newer Stop. Pure: no Zenoh, no clock.

Zenoh delivers the messages of one session in order, each into its key's ring. So after a Stop was taken from one ring,
each older message of its session was taken as well, or waits in its own ring. All rings that may hold a command for
one of the same servos (`core/targets.py`) are therefore read again, until nothing new is found. All that was found is
one instant, in which a Stop wins over a Start or Set of another ring (supervisor).

After a Start or Set, only the rings whose commands apply before it are read again (`legs` before `leg` before `servo`):
an older one of these must not apply later. Commands in the other rings apply after it, now or in a later instant.

During a flood of several keys this would never end, so the passes are limited. If rings are left after the last pass,
and a Stop may have been taken, the instant stays open: the next `read` still belongs to it. Setpoints alone close it,
since otherwise a stopped servo could not be started again while they keep coming.

A ring keeps its newest messages, so a flood of one key pushes out a Stop on the same key. A full ring is reported to
the reader: a Stop may have been lost. (A get that is pushed out gets no answer, which its sender notices.) A stream
that was delayed on the way and arrives at once is no flood: a ring of puts has room for it (`put_depth`). Only the
newest few are processed, and of the older ones those that may be Stops.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final, Generic, TypeVar

from gateway.robot.core.targets import follows, servos_of
from schemas.keys import COMMAND_KEYS

RING_DEPTH: Final = 8
"""Messages per ring and tick: enough for a start, a stop and some setpoints sent in one go; others are only older."""
STREAM_RATES: Final = 4
"""A stream of up to so many times `limits.leg_rate_hz` that was held back for the watchdog's time loses nothing."""
LEAST_PUT_DEPTH: Final = 16
MAX_PUT_DEPTH: Final = 1024
"""Puts of a key that are kept at most, such as for 1000 Hz and a watchdog of 0.25 s. By default 58 are. More cost time:
in a flood of 600 000 messages a second, 16 looks into a ring took 0.02 ms (p99 0.07), 64 took 0.06 ms (p99 0.4). And
memory: while the loop is held, a message may keep the 64 KiB that Zenoh received it in."""
PASSES: Final = 4
"""How often the rings are read for one instant at most. Without a flood the second pass finds nothing."""

Item = TypeVar("Item")
"""What Zenoh gives."""
Message = TypeVar("Message")
"""What is made of it."""
Receive = Callable[[], Item | None]
"""Takes a ring's oldest message; None: it is empty."""
WordsOfStop = Callable[[Message], bytes | None]
"""The words of a message that may be a Stop (it may take others for one, but misses none); None: it is not."""


def put_depth(leg_rate_hz: float, timeout_ms: float) -> int:
    """How many puts of a key are kept: a stream's that was held back for the watchdog's time, and some before them."""
    held_back = math.ceil(STREAM_RATES * leg_rate_hz * timeout_ms / 1000)
    return min(max(held_back + RING_DEPTH, LEAST_PUT_DEPTH), MAX_PUT_DEPTH)


class Ring(Generic[Item]):
    """The messages of one key and kind (`put` and `delete`, or `get`), in the order in which they came."""

    __slots__ = ("before", "depth", "follows", "key", "others", "place", "receive", "servos")

    def __init__(self, key: str, receive: Receive[Item], depth: int) -> None:
        self.key = key
        self.place: int
        """Where its commands stand among those of one instant."""
        self.servos = servos_of(COMMAND_KEYS[key])
        """Those that a message in it may stop. Without any (a reset), no message in it is a Stop."""
        self.follows = follows(COMMAND_KEYS[key])
        self.receive = receive
        self.depth = depth
        self.others: frozenset[Ring[Item]] = frozenset()
        """The rings that are read after a Stop was taken from this one: an older message may be in them."""
        self.before: frozenset[Ring[Item]] = frozenset()
        """Those of them whose commands apply before its own: they are read after anything else, too."""

    def rest(self, *first: Item) -> list[Item]:
        """`first` and the messages after it, at most the ring's depth; further ones wait for the next read."""
        found = [*first]
        while len(found) < self.depth and (item := self.receive()) is not None:
            found.append(item)
        return found


class Rings(Generic[Item, Message]):
    """All rings of commands; `receivers` has two for each key, `put` (of `depth`) and `get` (of RING_DEPTH)."""

    def __init__(
        self,
        receivers: Mapping[str, tuple[Receive[Item], Receive[Item]]],
        make: Callable[[str, Item], Message],
        words_of_stop: WordsOfStop[Message],
        depth: int = LEAST_PUT_DEPTH,
    ):
        self._make = make
        self._words_of_stop = words_of_stop
        self._of = {key: (Ring(key, put, depth), Ring(key, get, RING_DEPTH)) for key, (put, get) in receivers.items()}
        self._all = [ring for key in COMMAND_KEYS if key in self._of for ring in self._of[key]]
        for place, ring in enumerate(self._all):
            ring.place = place
            ring.others = frozenset(each for each in self._all if each is not ring and ring.follows & each.servos)
            ring.before = ring.others.intersection(self._all[:place])
        self.instant_open = False
        """Whether the next `read` belongs to the same instant as the last."""

    def read(self, keys: Collection[str] = ()) -> list[tuple[str, Message | None]]:
        """What waits in the rings of these keys (of all, if none is named) and of those that they concern.

        `legs` first, then `leg`, then `servo`, then resets; of one ring in its order. None: a Stop may
        have been lost before what follows of this key.
        """
        due: Collection[Ring[Item]] = self._all
        if keys and not self.instant_open:
            due = [ring for key in keys for ring in self._of[key]]
        taken: list[tuple[Ring[Item], Sequence[Message | None]]] = []
        stops = False
        for _ in range(PASSES):
            again: set[Ring[Item]] = set()
            for ring in due:
                if ring in again:
                    again.remove(ring)  # it is read now, after what made it due
                first = ring.receive()
                if first is not None:
                    second = ring.receive()
                    items: Sequence[Message | None]
                    items = (
                        [self._make(ring.key, first)] if second is None else self._made(ring, ring.rest(first, second))
                    )
                    taken += [(ring, items)]
                    if self._may_stop(ring, items):
                        stops = True
                        again |= ring.others
                    else:
                        again |= ring.before
            due = again
            if not due:
                break
        self.instant_open = bool(due) and stops
        if len(taken) > 1:
            taken.sort(key=_place)
        return [(ring.key, item) for ring, items in taken for item in items]

    def _may_stop(self, ring: Ring[Item], items: Sequence[Message | None]) -> bool:
        """Whether a Stop may be among them."""
        if ring.servos:
            for item in items:
                if item is None or self._words_of_stop(item) is not None:
                    return True
        return False

    def _made(self, ring: Ring[Item], found: list[Item]) -> Sequence[Message | None]:
        """The newest, and before them the older Stops, or None where some may have been lost."""
        newest = [self._make(ring.key, item) for item in found[-RING_DEPTH:]]
        if len(found) <= RING_DEPTH or not ring.servos:
            return newest
        if len(found) == ring.depth:
            return [None, *newest]
        stops: dict[bytes, Message] = {}
        for item in found[:-RING_DEPTH]:
            older = self._make(ring.key, item)
            words = self._words_of_stop(older)
            if words is not None:
                stops.pop(words, None)  # of the same, the last: a flood of Stops is not to be dealt with one by one
                stops[words] = older
        return [*stops.values(), *newest]


def _place(taken: tuple[Ring[Item], Sequence[Message | None]]) -> int:
    return taken[0].place
