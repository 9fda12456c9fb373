"""Rejects starts that may come from a backlog. Pure: time is an argument.

A link that stalls delivers a program's messages all at once, perhaps after the program has died. A command with
`sent_ms` shows its delay (`model/staleness.py`); without, only the messages that arrive with it do. So a burst of
messages without `sent_ms` on one key starts no stopped leg:

- A start waits for `Rules.start_wait_ns` before its leg's first frame. Delayed messages after it arrive within that
  time.
- More messages of one key within `Rules.window_ns` than its rate allows are a burst. The key's waiting starts are
  dropped, and further ones are rejected, until the watchdog's timeout has passed without a burst on the key: a link
  that loses packets delivers a backlog in pieces.

Running legs take every command, and a Stop is always carried out.
"""

from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model.frames import OP_START
from gateway.robot.core.events import Command, Effect
from gateway.robot.core.gates.rate import BUCKET
from gateway.robot.core.leg import Leg
from gateway.robot.core.legs import Legs
from gateway.robot.core.rules import Rules
from schemas.telemetry import Reason

START_WAIT_NS: Final = 15 * NS_PER_MS
"""The frame of a lone start leaves within a rate slot of 50 Hz, with 5 ms for a timer that is late."""


class Backlog:
    """The latest messages without `sent_ms` of each key, and the keys that have a burst."""

    def __init__(self, rules: Rules, legs: Legs) -> None:
        self._rules = rules
        self._legs = legs
        self._most = max(BUCKET, BUCKET - 1 + rules.window_ns // rules.period_ns)
        """The most messages that the rate limit allows in the window, with a full bucket."""
        self._came_ns: dict[str, tuple[int, ...]] = {}
        self._until_ns: dict[str, int] = {}
        self.held: dict[int, str] = {}
        """Legs that wait for a start without `sent_ms`, each with the key of that start."""

    def note(self, command: Command, now_ns: int) -> list[Effect]:
        """Count a command without `sent_ms`. If it belongs to a burst, drop its key's waiting starts."""
        if not self._rules.start_wait_ns or not command.moves:
            return []
        key = command.key
        came_ns = self._came_ns.get(key, ())
        self._came_ns[key] = (*came_ns, now_ns)[-self._most :]
        if len(came_ns) < self._most or now_ns - came_ns[0] >= self._rules.window_ns:
            return []
        self._until_ns[key] = now_ns + self._rules.timeout_ns
        legs = [self._legs.by_number[number] for number, held in self.held.items() if held == key]
        waiting = [servo for leg in legs if not leg.runs for servo in leg.servos]
        return self._legs.drop(waiting, Reason.STALE, _why(key))

    def rejection(self, command: Command, now_ns: int) -> tuple[Reason, str] | None:
        """Return why a command without `sent_ms` is rejected (a burst would start a stopped leg), or None."""
        if now_ns >= self._until_ns.get(command.key, now_ns):
            return None
        return (Reason.STALE, _why(command.key)) if self._starting(command) else None

    # mutants accepted (Forget): without a waiting start both do nothing
    def hold(self, command: Command, now_ns: int) -> None:
        """Delay the legs that an accepted command starts without `sent_ms`. With `sent_ms`, end their delay."""
        if not self._rules.start_wait_ns:
            return
        self.held = {number: key for number, key in self.held.items() if not self._legs.by_number[number].runs}
        for leg in self._starting(command):
            if command.sent_ms is not None:
                self.held.pop(leg.number, None)
            elif not leg.armed:
                self.held[leg.number] = command.key
                leg.slots.wait_until(now_ns + self._rules.start_wait_ns)

    def _starting(self, command: Command) -> list[Leg]:
        numbers = dict.fromkeys(servo_id // 10 for servo_id, op in command.moves if op.op is OP_START)
        return [leg for leg in map(self._legs.by_number.__getitem__, numbers) if not leg.runs]


def _why(key: str) -> str:
    return (
        f"more messages came on {key} at once than its rate allows, so they were delayed; send sent_ms, or start again"
    )
