"""Which rings are read when, so that no older Start overtakes a newer Stop. Plain Python: no Zenoh, no clock.

Zenoh delivers the messages of one session one after another, each into its key's ring. So when a Stop has been taken
from one ring, every older message of its session has been taken as well, or waits in its own ring. All rings that may
hold a command for one of the same servos are therefore read again after it, and again until nothing new is found. What
was found in one go is one instant, in which a Stop wins over a Start or Set of another ring (supervisor).

A flood of several keys could go on like this for ever, so the passes are limited. If the last one leaves rings to be
read, and a Stop may be among what was taken, then the instant stays open: what is read next still belongs to it. Mere
setpoints close it all the same, since a servo that was stopped once could not be started again while they come.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Final, Generic, TypeVar

from schemas.keys import COMMAND_KEYS, RESET, CommandKey, Target

RING_DEPTH: Final = 8
"""Messages per key and tick: enough for a start, a stop and some setpoints sent in one go; more would only be older."""
PASSES: Final = 4
"""How often the rings are read for one instant at most. Without a flood the second pass finds nothing."""

Item = TypeVar("Item")
Receive = Callable[[], Item | None]
"""Takes a ring's oldest message; None: it is empty."""


class Ring(Generic[Item]):
    """The messages of one key and kind (`put` and `delete`, or `get`), in the order in which they came."""

    __slots__ = ("key", "others", "place", "receive")

    def __init__(self, key: str, place: int, receive: Receive[Item]) -> None:
        self.key = key
        self.place = place
        """Where its commands stand among those of one instant."""
        self.receive = receive
        self.others: frozenset[Ring[Item]] = frozenset()
        """The rings that are read after something was taken from this one: an older message may be in them."""

    def rest(self, first: Item) -> list[Item]:
        """`first`, and what came after it, at most a ring's depth: what comes meanwhile is left for the next time."""
        found = [first]
        while len(found) < RING_DEPTH and (item := self.receive()) is not None:
            found.append(item)
        return found


class Rings(Generic[Item]):
    """All rings of commands; `receivers` has two for each key, `put` and `get`."""

    def __init__(self, receivers: Mapping[str, tuple[Receive[Item], Receive[Item]]], may_stop: Callable[[Item], bool]):
        self._may_stop = may_stop
        places = {key: place for place, key in enumerate(COMMAND_KEYS)}
        self._of = {
            key: (Ring(key, 2 * places[key], put), Ring(key, 2 * places[key] + 1, get))
            for key, (put, get) in receivers.items()
        }
        self._all = [ring for key in COMMAND_KEYS if key in self._of for ring in self._of[key]]
        for ring in self._all:
            ring.others = frozenset(
                other for other in self._all if other is not ring and _concerns(ring.key, other.key)
            )
        self.instant_open = False
        """Whether the next `read` belongs to the same instant as the last."""

    def read(self, keys: Collection[str] = ()) -> list[tuple[str, Item]]:
        """What waits in the rings of these keys (of all, if none is named) and of those that they concern.

        `legs` first, then `leg`, then `servo`, then resets; of one ring in its order.
        """
        due: Collection[Ring[Item]] = self._all
        if keys and not self.instant_open:
            due = [ring for key in keys for ring in self._of[key]]
        taken: list[tuple[Ring[Item], list[Item]]] = []
        for _ in range(PASSES):
            again: set[Ring[Item]] = set()
            for ring in due:
                if again:
                    again.discard(ring)  # it is read now, after what made it due
                first = ring.receive()
                if first is not None:
                    taken.append((ring, ring.rest(first)))
                    again |= ring.others
            due = again
            if not due:
                break
        # A reset is no Stop, although its payload names the emergency stop.
        self.instant_open = bool(due) and any(
            self._may_stop(item) for ring, items in taken if ring.key != RESET for item in items
        )
        if len(taken) > 1:
            taken.sort(key=_place)
        return [(ring.key, item) for ring, items in taken for item in items]


def _place(taken: tuple[Ring[Item], list[Item]]) -> int:
    return taken[0].place


def _concerns(key: str, other: str) -> bool:
    """Whether what was taken from `key` makes an older message on `other` matter."""
    one, two = COMMAND_KEYS[key], COMMAND_KEYS[other]
    if Target.RESET in (one.target, two.target):
        # What was sent while the emergency stop was engaged is rejected, also where the reset after it is seen first.
        return one.target is Target.RESET
    return Target.LEGS in (one.target, two.target) or (
        _leg(one) == _leg(two) and (one.target is not two.target or one.number == two.number)
    )


def _leg(key: CommandKey) -> int:
    return key.number // 10 if key.target is Target.SERVO else key.number
