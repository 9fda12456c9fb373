"""Stops a leg without commands; if a landing is configured, the robot lands first. Pure.

A leg that runs or waits to be started is stopped if no accepted command starts or sets one of its servos within the
timeout. A Stop for one servo does not keep the others running.

If a leg or a button falls silent, or the body is tilted, the whole robot lands on all legs: with one limp leg it would
fall. Nothing prolongs a landing: commands are rejected even if the link returns, and another silent leg's own Stop
would be due later than the landing's end.
"""

from typing import Final, Never

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import Announce, Calibrate, Command, Effect
from gateway.robot.core.interlock import ALL_LEGS, Interlock
from gateway.robot.core.legs import Halt, Legs
from gateway.robot.core.rules import Rules
from schemas.words import Cause, Kind, Reason

_LANDING: Final = "the robot lands; start it once all legs are stopped"


class Watchdog(Interlock[Never]):
    """The legs' deadlines, and the landing in progress: then it is `closed`."""

    bars = (Command, Calibrate)
    of_legs = True
    objection = (Reason.LANDING, _LANDING)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self.expirations = 0
        """How often a leg was silent for the timeout since the start."""

    def expire(self, now_ns: int) -> list[Effect]:
        rules, legs = self._rules, self._legs
        if legs.landing_ends_ns is not None:
            if now_ns < legs.landing_ends_ns:
                return []
            due = dict.fromkeys(legs.by_number, legs.landing_ends_ns)
            legs.landing_ends_ns = None
            done = "all six legs are stopped"
            ended = Announce(Kind.WATCHDOG_EXPIRED, "the landing has ended", legs=ALL_LEGS, done=done)
            return [*self._stop(due, now_ns, *self.objection), ended]
        deadlines = [(leg.number, leg.deadline_ns(rules.timeout_ns)) for leg in legs]
        silent = {number: deadline for number, deadline in deadlines if deadline is not None and now_ns >= deadline}
        if not silent:
            return []
        self.expirations += len(silent)
        timeout_ms = rules.timeout_ns / NS_PER_MS
        first = min(silent.values())
        landing = self._land(f"no command for leg {min(silent)} in {timeout_ms:g} ms", first, now_ns)
        if landing:
            return landing
        due = {leg.number: silent.get(leg.number, first) for leg in legs} if rules.stops_whole else silent
        effects = self._stop(due, now_ns, Reason.STALE, "the command was pending longer than the watchdog allows")
        done = "all six legs are stopped" if rules.stops_whole else "it is stopped"
        done += ", since this robot can only be stopped as a whole" if rules.starts_whole else ""
        for number in silent:
            detail = f"no command for leg {number} in {timeout_ms:g} ms"
            stopped = ALL_LEGS if rules.stops_whole else (number,)
            effects.append(Announce(Kind.WATCHDOG_EXPIRED, detail, legs=stopped, done=done))
        return effects

    def _stop(self, due: dict[int, int], now_ns: int, reason: Reason, detail: str) -> list[Effect]:
        """Stop these legs, and mark those as expired that ran or waited to be started."""
        expired = [leg for leg in self._legs if leg.number in due and leg.armed]
        effects = self._legs.stop(due, Halt(Cause.WATCHDOG, reason, detail), now_ns)
        for leg in expired:
            leg.expired = True
        return effects
