"""How many bytes the controller may still await, where transfers may have been lost. Pure.

With LENGTH_PREFIXED framing the controller reads a length, then awaits that many bytes. A call that failed may have
ended behind any of its transfers, so afterwards there are several possibilities. Each later byte moves all of them, and
a frame is executed where the only one that is left before it is 0: the controller awaits a length.

A Stop of a whole leg brings a controller back that still awaits the body of another such frame: its announcement and
thirteen of its bytes fill that body (whose type is then no type, so it is ignored), and its last byte is a length of 0,
which is ignored too. So two transfers do what takes fourteen zeros. From wherever a controller is, Stops and zeros are
executed as Stops, or not executed (`tests/unit/robot/test_awaited.py` tries each).
"""

import heapq
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Final

from gateway.model.frames import ONE_LEG_LEN
from gateway.model.framing import ZERO

NOTHING: Final = frozenset({0})
"""The controller is synchronised: it awaits a length."""
ANYTHING: Final = frozenset(range(ONE_LEG_LEN + 1))
"""A program before this one may have left it with an announcement and any part of the zeros of a preamble."""

_MOST_TRANSFERS: Final = 6
"""How far ahead a way back is looked for: three Stops. Of more, one would fail and scatter the possibilities, which a
zero that fails does not."""

Awaited = frozenset[int]


def after(awaited: Awaited, transfers: Iterable[bytes]) -> Awaited:
    """What it may await once all these transfers have arrived."""
    for data in transfers:
        awaited = frozenset(_after(each, data) for each in awaited)
    return awaited


def after_failure(awaited: Awaited, transfers: Iterable[bytes]) -> Awaited:
    """What it may await where the call of these transfers failed, and nobody knows how many of them arrived."""
    possible = set(awaited)
    for data in transfers:
        awaited = after(awaited, (data,))
        possible |= awaited
    return frozenset(possible)


def after_stall(awaited: Awaited, transfers: Sequence[bytes]) -> Awaited:
    """What it may await where their call took so much time that the controller may have given up a frame within it.

    It then takes the rest, such as a body without its announcement, for lengths.
    """
    possible = set(after_failure(awaited, transfers))
    for place in range(len(transfers)):
        possible |= after_failure(NOTHING, transfers[place:])
    return frozenset(possible)


@lru_cache(maxsize=4096)
def next_on_the_way_back(awaited: Awaited, stops: tuple[bytes, ...]) -> bytes:
    """What to write next, of these Stops and the zero, so that the fewest transfers bring the controller back.

    With `NOTHING` awaited it is the first Stop.
    """
    if awaited == NOTHING:
        return stops[0]
    units = {**{stop: (stop[:1], stop) for stop in stops}, ZERO: (ZERO,)}
    ways: list[tuple[int, int, Awaited, bytes]] = [(0, 0, awaited, b"")]
    seen: set[Awaited] = set()
    number = 0
    while ways:
        transfers, _, reached, first = heapq.heappop(ways)
        if reached == NOTHING:
            return first
        if reached in seen:
            continue
        seen.add(reached)
        for unit, parts in units.items():
            if transfers + len(parts) <= _MOST_TRANSFERS:
                number += 1  # of two ways of one length, the one that was found first
                heapq.heappush(ways, (transfers + len(parts), number, after(reached, parts), first or unit))
    return ZERO


def _after(awaited: int, data: bytes) -> int:
    for byte in data:
        awaited = awaited - 1 if awaited else byte
    return awaited
