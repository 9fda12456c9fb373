"""The power board's outputs that have to be off: which are confirmed, and which requests wait for that. Pure.

Masks have numbers. An output is confirmed off by an answer 6B that shows it off, given after the mask that cut it (or a
later mask) had reached the board (questions.py).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import OUTPUTS


class Confirmed(NamedTuple):
    """The answer to a `when_off`: whether the board confirmed that these servos are off, and after how many ms."""

    token: int
    confirmed: bool
    ms: float | None


class _Wait(NamedTuple):
    """A request that waits until the outputs of `mask` are confirmed off, by mask number `number` or later."""

    token: int
    mask: int
    asked_ns: int
    number: int


@dataclass(slots=True)
class _Off:
    """An off: the number of the first mask for it, since when, and whether it is confirmed."""

    number: int
    since_ns: int
    confirmed: bool = False


class OutputsOff:
    """The outputs of one board. In masks, bit n - 1 is output n."""

    def __init__(self, confirm_ns: int) -> None:
        """An off not confirmed within `confirm_ns` is late."""
        self._confirm_ns = confirm_ns
        self._offs: dict[int, _Off] = {}
        self._waits: list[_Wait] = []

    @property
    def mask(self) -> int:
        """The outputs that have to be off."""
        return sum(1 << place for place in self._offs)

    @property
    def unconfirmed(self) -> int:
        """The outputs that have to be off and are not confirmed."""
        return sum(1 << place for place, off in self._offs.items() if not off.confirmed)

    def take(self, mask: int, number: int, now_ns: int) -> None:
        """Record that these outputs have to be off, confirmed by the mask with this number or a later one."""
        for place in _places(mask):
            off = self._offs.get(place)
            since_ns = now_ns if off is None or off.confirmed else off.since_ns
            self._offs[place] = _Off(number, since_ns)

    def feed(self, mask: int) -> None:
        """Record that these outputs have to be on."""
        for place in _places(mask):
            self._offs.pop(place, None)

    def have_reached(self, mask: int, reached: int) -> bool:
        """Return whether the board has all masks that cut these outputs. `reached` is the newest mask that it has."""
        return all(self._offs[place].number <= reached for place in _places(mask & self.mask))

    def wait(self, mask: int, asked_ns: int, token: int, newest: int) -> None:
        """Wait for these outputs. A `Confirmed` follows, `confirm_ns` after `asked_ns` at the latest.

        `newest` is the number of the newest mask.
        """
        number = max((self._offs[place].number for place in _places(mask & self.mask)), default=newest)
        self._waits.append(_Wait(token, mask, asked_ns, number))

    def answered(self, shown: int, reached: int, now_ns: int) -> tuple[int, list[Confirmed]]:
        """Take a 6B that shows the outputs `shown` as on, after the masks up to `reached`.

        Return the outputs that are on again after they were confirmed off, and the answers to waiting requests.
        """
        on_again = shown & self.mask & ~self.unconfirmed
        for place in _places(self.mask & ~shown):
            off = self._offs[place]
            off.confirmed = off.confirmed or off.number <= reached
        ended = [wait for wait in self._waits if not shown & wait.mask and wait.number <= reached]
        return on_again, [
            Confirmed(wait.token, True, (now_ns - wait.asked_ns) / NS_PER_MS) for wait in self._end(ended)
        ]

    def late(self, now_ns: int) -> tuple[int, list[Confirmed]]:
        """Return the outputs that were not confirmed in time, and the answers to requests that waited too long."""
        late = [place for place in _places(self.unconfirmed) if now_ns - self._offs[place].since_ns >= self._confirm_ns]
        ended = [wait for wait in self._waits if now_ns - wait.asked_ns >= self._confirm_ns]
        return sum(1 << place for place in late), [Confirmed(wait.token, False, None) for wait in self._end(ended)]

    def _end(self, waits: list[_Wait]) -> list[_Wait]:
        for wait in waits:
            self._waits.remove(wait)
        return waits


def _places(mask: int) -> Iterator[int]:
    return (place for place in range(OUTPUTS) if mask >> place & 1)
