"""The emergency stop: it stops six legs and latches. A reset leaves the latch and starts nothing. Pure."""

from typing import Final

from gateway.rate_limit import NS_PER_S
from gateway.robot.core.events import Announce, Completed, Effect, EmergencyStop, EstopKept, Rejected, Reset
from gateway.robot.core.interlock import Interlock
from gateway.robot.core.legs import Halt, Legs
from gateway.robot.core.rules import Rules
from schemas.words import Cause, Kind, Reason

ESTOPPED: Final = "the emergency stop is engaged; reset it first"
_UNKNOWN: Final = "it is not known yet whether an earlier run has left an emergency stop engaged"


class Latch(Interlock[EmergencyStop | Reset | EstopKept]):
    """The state of the emergency stop. While it is engaged, the supervisor's mode rejects commands."""

    takes = (EmergencyStop, Reset, EstopKept)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self.number = 0
        """The number of the latest emergency stop; 0: none. It continues from the run before."""
        self.since_ns: int | None = None
        """The instant of the latest emergency stop; None: none is engaged."""
        self.unknown = rules.estop_kept
        """Whether an earlier run may have left it engaged. Until `EstopKept` it counts as engaged."""

    def halts(self, event: EmergencyStop | Reset | EstopKept) -> Halt | None:
        if type(event) is not EmergencyStop:
            return None
        return Halt(Cause.ESTOP, Reason.ESTOPPED, ESTOPPED, (event.source, event.source_id))

    def take(self, event: EmergencyStop | Reset | EstopKept, now_ns: int) -> list[Effect]:  # noqa: ARG002
        legs = self._legs
        match event:
            case EmergencyStop():
                first = self.since_ns is None
                self.number += 1
                self.since_ns = legs.instant_ns  # not now: a reset of the same instant may be older
                detail, done = "emergency stop; all commands are rejected until a reset", "all six legs are stopped"
                if not legs.sends:
                    done = f"{self._rules.wire} does not answer, and the Stop frames follow as soon as it does"
                source, key, source_id = event.source, event.key, event.source_id
                engaged = Announce(Kind.ESTOP_ENGAGED, detail, source, key, done=done, source_id=source_id)
                return [engaged] if first else []
            case Reset():
                return self._leave(event, legs.instant_ns)
            case EstopKept():  # this run's emergency stops are numbered after the earlier run's
                self.unknown = False
                self.number += event.number
                if event.engaged and self.since_ns is None:
                    self.since_ns = legs.instant_ns
                return []

    def _leave(self, reset: Reset, instant_ns: int) -> list[Effect]:
        why_not = self._why_not_left(reset.estop, instant_ns)
        if why_not is not None:
            return [Rejected(reset, Reason.ESTOPPED, why_not)]
        if self.since_ns is None:
            return [Completed(reset)]
        self.since_ns = None
        detail = "the emergency stop has ended; nothing moves until somebody starts it"
        ended = Announce(Kind.ESTOP_RESET, detail, reset.source, reset.key, source_id=reset.source_id)
        return [ended, Completed(reset)]

    # mutants accepted (Lt_LtE): equal numbers were answered before
    def _why_not_left(self, names: int | None, instant_ns: int) -> str | None:
        """Return why a reset does not leave the emergency stop, or None if it does or none is engaged.

        A reset may have been sent before the latest emergency stop. `names` is the number of the emergency stop that it
        leaves; None: the reset has no number.
        """
        if self.unknown or self.since_ns is None:
            return _UNKNOWN if self.unknown else None
        age_ns = instant_ns - self.since_ns
        if age_ns == 0:
            return "the emergency stop was engaged in the same instant"
        if names is None:
            if age_ns >= self._rules.unnumbered_reset_ns:
                return None
            return (
                f"the emergency stop was requested {age_ns / NS_PER_S:.1f} s ago; a reset without its number (estop) "
                f"is accepted after {self._rules.unnumbered_reset_ns / NS_PER_S:g} s"
            )
        if names == self.number:
            return None
        what = "a newer" if names < self.number else "no such"
        return f"{what} emergency stop was requested: estop is {names}, and the latest is {self.number}"
