"""How many bytes the controller may still await after transfers that may have been lost. Pure.

With LENGTH_PREFIXED framing the controller reads a length, then awaits that many bytes. A failed call may have ended
after any of its transfers, which leaves several possibilities. Each further byte advances all of them. A frame is
certainly executed if the only possibility before it is 0: the controller awaits a length.

A Stop of a whole leg resynchronises a controller that awaits the body of another such frame. The Stop's announcement
and thirteen of its bytes fill that body, which is ignored for its wrong type; its last byte is a length of 0, also
ignored. So two transfers do the work of fourteen zeros. In every state, a controller executes Stops and zeros as Stops
or ignores them (`tests/unit/robot/test_bus.py` tries each).
"""

from collections.abc import Iterable, Sequence
from typing import Final

from gateway.model.frames import ONE_LEG_LEN

NOTHING: Final = frozenset({0})
"""The controller is synchronised: it awaits a length."""
ANYTHING: Final = frozenset(range(ONE_LEG_LEN + 1))
"""An earlier program may have left the controller after an announcement and any part of a preamble's zeros."""

Awaited = frozenset[int]


def after(awaited: Awaited, data: bytes) -> Awaited:
    """Return what the controller may await once all these bytes have arrived."""
    for byte in data:
        awaited = frozenset([each - 1 if each else byte for each in awaited])
    return awaited


def after_failure(awaited: Awaited, transfers: Iterable[bytes]) -> Awaited:
    """Return what the controller may await after a failed call, of which any number of transfers may have arrived."""
    possible = awaited
    for data in transfers:
        awaited = after(awaited, data)
        possible |= awaited
    return possible


def after_stall(awaited: Awaited, transfers: Sequence[bytes]) -> Awaited:
    """Return what the controller may await after a call so slow that the controller may have given up a frame in it.

    The controller then takes the rest, such as a body without its announcement, for lengths.
    """
    possible = after_failure(awaited, transfers)
    return possible.union(*(after_failure(NOTHING, transfers[place:]) for place in range(len(transfers))))
