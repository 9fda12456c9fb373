"""The servos whose supply has to be off: which are confirmed, and which requests wait for that. Pure.

Masks have numbers. A servo is confirmed off by an answer 6B that shows it off, given after the mask that cut it (or a
later mask) had reached the board (questions.py).
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from gateway.allowance import NS_PER_MS


class Confirmed(NamedTuple):
    """The answer to a `when_off`: after how many ms the board has confirmed these servos off; None: not in time."""

    token: int
    ms: float | None


class _Wait(NamedTuple):
    """A request that waits until these servos are confirmed off, by mask number `number` or later."""

    token: int
    servos: frozenset[int]
    asked_ns: int
    number: int


@dataclass(slots=True)
class _Off:
    """An off: the number of the first mask for it, since when, and whether it is confirmed."""

    number: int
    since_ns: int
    confirmed: bool = False


class OutputsOff:
    def __init__(self, confirm_ns: int) -> None:
        """An off not confirmed within `confirm_ns` is late."""
        self._confirm_ns = confirm_ns
        self._offs: dict[int, _Off] = {}
        self._waits: list[_Wait] = []

    @property
    def servos(self) -> frozenset[int]:
        """The servos that have to be off."""
        return frozenset(self._offs)

    @property
    def unconfirmed(self) -> frozenset[int]:
        """The servos that have to be off and are not confirmed."""
        return frozenset(servo for servo, off in self._offs.items() if not off.confirmed)

    def take(self, servos: Collection[int], number: int, now_ns: int) -> None:
        """Record that these servos have to be off, confirmed by the mask with this number or a later one."""
        for servo in servos:
            off = self._offs.get(servo)
            self._offs[servo] = _Off(number, now_ns if off is None or off.confirmed else off.since_ns)

    def feed(self, servos: Collection[int]) -> None:
        """Record that these servos have to be on."""
        for servo in servos:
            self._offs.pop(servo, None)

    def number(self, servos: Collection[int], default: int) -> int:
        """Return the number of the mask that cuts the last of these servos, or `default` if none has to be off."""
        return max((off.number for servo, off in self._offs.items() if servo in servos), default=default)

    def wait(self, servos: frozenset[int], asked_ns: int, token: int, newest: int) -> None:
        """Wait for these servos. A `Confirmed` follows, `confirm_ns` after `asked_ns` at the latest.

        `newest` is the number of the newest mask.
        """
        self._waits.append(_Wait(token, servos, asked_ns, self.number(servos, newest)))

    def answered(self, shown: frozenset[int], reached: int, now_ns: int) -> tuple[set[int], list[Confirmed]]:
        """Take a 6B that shows the servos `shown` as on, after the masks up to `reached`.

        Return the servos that are on again after they were confirmed off, and the answers to waiting requests.
        """
        on_again = {servo for servo, off in self._offs.items() if servo in shown and off.confirmed}
        for servo, off in self._offs.items():
            off.confirmed = off.confirmed or (servo not in shown and off.number <= reached)
        ended = [wait for wait in self._waits if wait.number <= reached and shown.isdisjoint(wait.servos)]
        self._waits = [wait for wait in self._waits if wait not in ended]
        return on_again, [Confirmed(wait.token, (now_ns - wait.asked_ns) / NS_PER_MS) for wait in ended]

    def late(self, now_ns: int) -> tuple[frozenset[int], list[Confirmed]]:
        """Return the servos that were not confirmed in time, and the answers to requests that waited too long."""
        late = frozenset(each for each in self.unconfirmed if now_ns - self._offs[each].since_ns >= self._confirm_ns)
        ended = [wait for wait in self._waits if now_ns - wait.asked_ns >= self._confirm_ns]
        self._waits = [wait for wait in self._waits if wait not in ended]
        return late, [Confirmed(wait.token, None) for wait in ended]
