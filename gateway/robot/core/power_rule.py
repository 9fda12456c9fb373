"""Rejects starts and moves without power, and stops a servo that loses its power. Pure.

A start leaves once the board has confirmed its servo's power. A servo without power is stopped on the wire, too: with
power again, it would jump to its angle. While the board is silent, no servo is lost: a landing robot may have power.
"""

from collections.abc import Collection, Mapping
from typing import Any, Final

from gateway.model.frames import legs_of
from gateway.robot.core.events import Effect, PowerSeen
from gateway.robot.core.interlock import Down, Halt, Interlock, Why
from gateway.robot.core.legs import Legs
from gateway.robot.core.rules import Rules
from schemas.telemetry import Cause, Reason

SILENT: Final = "the power board does not answer"


class PowerRule(Interlock[PowerSeen]):
    """Rejects moves of servos that the board does not power, and stops their legs."""

    takes = (PowerSeen,)
    objection = (Reason.NO_POWER, SILENT)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self.alive = not rules.power
        self.closed = rules.power
        self._refused: Mapping[int, str] = {}

    def why_not(self, request: Any) -> Why | None:
        if not self.alive:
            return self.objection
        for servo_id, _ in request.moves:
            if servo_id in self._refused:
                return Reason.NO_POWER, f"servo {servo_id} is not fed: {self._refused[servo_id]}"
        return None

    def overdue(self, now_ns: int) -> list[Effect]:
        if self._legs.landing_ends_ns is not None:
            return []
        since_ns = now_ns - self._rules.feed_ns
        unfed = [leg.number for leg in self._legs if leg.unfed_ns is not None and leg.unfed_ns <= since_ns]
        return self._stop(unfed, "the power board has not confirmed that it is fed", now_ns)

    def halts(self, event: PowerSeen) -> Halt | None:
        return Halt(Cause.WATCHDOG, Reason.NO_POWER, event.doubt) if event.doubt else None

    # mutants accepted (Forget): only time is lost
    def take(self, event: PowerSeen, now_ns: int) -> list[Effect]:
        legs = self._legs
        self.alive, self._refused = event.alive, dict(event.refused)
        self.closed = not event.alive or bool(event.refused)
        self.down = None if event.alive else Down(SILENT, None)
        if legs.gates.supply.fed is not None:
            legs.gates.supply.fed = event.fed
        if not (legs.sends and event.alive):
            return []
        lost = legs_of(each for each in (*event.lost, *self._refused) if legs.servos[each].will_run)
        return [*self._stop(lost, "the power board does not feed it any more", now_ns), *legs.start_fed(now_ns)]

    def _stop(self, unfed: Collection[int], detail: str, now_ns: int) -> list[Effect]:
        """Stop these legs, or all six if the robot only stops as a whole."""
        legs = self._legs
        due = dict.fromkeys(legs.by_number if unfed and self._rules.stops_whole else sorted(unfed))
        return legs.stop(due, Cause.WATCHDOG, now_ns, Reason.NO_POWER, detail) if due else []
