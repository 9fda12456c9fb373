"""Stops a leg without commands; if a landing is configured, the robot lands first. Pure.

A leg that runs or waits to be started is stopped if no accepted command starts or sets one of its servos within the
timeout. A Stop for one servo does not keep the others running.

If a leg or a button falls silent, or the body is tilted, the whole robot lands on all legs: with one limp leg it would
fall. Nothing prolongs a landing: commands are rejected even if the link returns, and another silent leg's own Stop
would be due later than the landing's end.
"""

from typing import Any, Final, Never

from gateway.allowance import NS_PER_MS
from gateway.model.angle_limits import AngleLimits
from gateway.robot.core.events import Announce, Calibrate, Command, Effect
from gateway.robot.core.interlock import ALL_LEGS, Down, Interlock, Why, nothing_to_stop
from gateway.robot.core.leg import Rules
from gateway.robot.core.legs import Legs
from schemas.telemetry import Cause, Kind, Reason

_LANDING: Final = "the robot lands; start it once all legs are stopped"


class Watchdog(Interlock[Never]):
    """The legs' deadlines, and the landing in progress: then it is `closed`."""

    bars = (Command, Calibrate)

    def __init__(self, rules: Rules, limits: AngleLimits) -> None:
        super().__init__(rules, limits)
        self.expirations = 0
        """How often a leg was silent for the timeout since the start."""

    def why_not(self, request: Any, legs: Legs) -> Why:  # noqa: ARG002
        return Reason.LANDING, _LANDING

    def overdue(self, now_ns: int, legs: Legs) -> list[Effect]:
        if legs.landing is not None:
            return self._touch_down(legs.landing.ends_ns, now_ns, legs)
        rules = self._rules
        deadlines = [(leg.number, leg.deadline_ns(rules.timeout_ns)) for leg in legs]
        silent = {number: deadline for number, deadline in deadlines if deadline is not None and now_ns >= deadline}
        if not silent:
            return []
        self.expirations += len(silent)
        timeout_ms = rules.timeout_ns / NS_PER_MS
        first = min(silent.values())
        ends_ns = first + rules.landing_ns
        if now_ns < ends_ns and legs.running:
            why = f"no command for leg {min(silent)} in {timeout_ms:g} ms"
            return _begin_landing(why, ends_ns, now_ns, legs, rules)
        due = {leg.number: silent.get(leg.number, first) for leg in legs} if rules.stops_whole else silent
        expired = [leg for leg in legs if leg.number in due and leg.armed]
        detail = "the command was pending longer than the watchdog allows"
        effects = legs.stop(due, Cause.WATCHDOG, now_ns, Reason.STALE, detail)
        for leg in expired:
            leg.expired = True
        whole = "; all six legs are stopped" if rules.stops_whole else "; it is stopped"
        whole += ", since this robot can only be stopped as a whole" if rules.starts_whole else ""
        for number in silent:
            detail = f"no command for leg {number} in {timeout_ms:g} ms{whole}"
            stopped = ALL_LEGS if rules.stops_whole else (number,)
            effects.append(Announce(Kind.WATCHDOG_EXPIRED, detail, legs=stopped))
        return effects

    def _touch_down(self, ends_ns: int, now_ns: int, legs: Legs) -> list[Effect]:
        if now_ns < ends_ns:
            return []
        armed = [leg for leg in legs if leg.armed]
        legs.landing = None
        effects = legs.stop(dict.fromkeys(legs.by_number, ends_ns), Cause.WATCHDOG, now_ns, Reason.LANDING, _LANDING)
        for leg in armed:
            leg.expired = True
        detail = "the robot has landed; all six legs are stopped"
        return [*effects, Announce(Kind.WATCHDOG_EXPIRED, detail, legs=ALL_LEGS)]


def bring_down(down: Down, now_ns: int, legs: Legs, rules: Rules) -> list[Effect]:
    """Land the robot if a servo runs and time is left, else stop all six legs. Return the effects."""
    if nothing_to_stop(legs):
        return []
    since_ns = now_ns if down.since_ns is None else down.since_ns
    ends_ns = since_ns + rules.landing_ns
    if now_ns < ends_ns and legs.running:
        return _begin_landing(down.why, ends_ns, now_ns, legs, rules)
    due = dict.fromkeys(legs.by_number, since_ns)
    return legs.stop(due, Cause.WATCHDOG, now_ns, down.reason, down.detail)


def _begin_landing(why: str, ends_ns: int, now_ns: int, legs: Legs, rules: Rules) -> list[Effect]:
    dropped = legs.begin_landing(now_ns, ends_ns)
    detail = f"{why}; the robot lands, and is stopped {rules.landing_ns / NS_PER_MS:g} ms later"
    return [*dropped, Announce(Kind.LANDING, detail, legs=ALL_LEGS)]
