"""Decides which servos the power board powers, rejects moves without power, and stops a servo that loses it. Pure.

With either wire, a servo is powered only while it runs or waits to be started. A Stop therefore cuts its power, and the
end of an emergency stop or of a bus fault powers no servo. A start leaves once the board has confirmed its servo's
power. A servo without power is stopped on the wire, too: with power again, it would jump to its angle. While the board
is silent, no servo is lost: a landing robot may have power.

A deaf controller may still drive servos. After a fault, one servo is powered alone; the others follow once its current
shows that it rests.
"""

from collections.abc import Collection
from typing import Any, Final

from gateway.model.frames import legs_of
from gateway.robot.core.events import Announce, ClearErrors, Cut, Effect, Feed, PowerSeen
from gateway.robot.core.interlock import ALL_LEGS, Down, Interlock, Why
from gateway.robot.core.legs import Halt, Legs
from gateway.robot.core.rules import Rules
from schemas.words import Cause, Kind, Mode, Reason

SILENT: Final = "the power board does not answer"
_WHY: Final = {
    Mode.ESTOPPED: "for the emergency stop",
    Mode.BUS_FAULT: "since the controller cannot be commanded to stop",
    Mode.STOPPING: "since the gateway ends",
}
"""The modes in which all power is cut, and why."""
_DREW: Final = "it drew current after its Stop; a reset feeds it again"
_DEAF: Final = "servo {} drew current before it was started: the controller does not obey; a reset lets it try again"
_TAKEN: Final = "another program has switched it off; a reset feeds it again"


class PowerRule(Interlock[PowerSeen]):
    """What the power board powers, and which servos wait for a reset."""

    takes = (PowerSeen,)
    of_legs = True
    objection = (Reason.NO_POWER, SILENT)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self.alive = not rules.power
        self.closed = rules.power
        self.trusted = rules.angles_first
        """Whether a powered servo was seen at rest since the last fault, or supply starts servos."""
        self._blocked: dict[int, str] = {}
        """Servos that the board will not power before a reset, and why."""
        self._withheld: dict[int, str] = {}
        """Servos that are not to be powered before a reset, and why."""
        self._asked: dict[int, int | None] = {}
        """What the latest step feeds, as in Feed."""
        self._cause: tuple[str | None, int] = None, 0  # mutants accepted (Step): no cause has a number
        """Why all power is cut, and the number of the newest emergency stop; as of the latest step."""
        self._cut = False
        """Whether all power was cut, and no servo has been powered since."""

    # ---- what starts and what stops

    def why_not(self, request: Any) -> Why | None:
        if not self.alive:
            return self.objection
        refused = self._withheld | self._blocked
        for servo_id, _ in request.moves:
            if servo_id in refused:
                return Reason.NO_POWER, f"servo {servo_id} is not fed: {refused[servo_id]}"
        return None

    def expire(self, now_ns: int) -> list[Effect]:
        if self._legs.landing_ends_ns is not None:
            return []
        since_ns = now_ns - self._rules.feed_ns
        unfed = [leg.number for leg in self._legs if leg.unfed_ns is not None and leg.unfed_ns <= since_ns]
        return self._stop(unfed, "the power board has not confirmed that it is fed", now_ns)

    def halts(self, event: PowerSeen) -> Halt | None:
        unpowered = [detail for servo_id, detail in event.drew if servo_id not in self._asked]
        doubt = next(filter(None, (event.doubt, *unpowered, self._deaf(event))), None)
        return None if doubt is None else Halt(Cause.WATCHDOG, Reason.NO_POWER, doubt)

    def _deaf(self, event: PowerSeen) -> str:
        """Return why the controller seems not to obey: the servo that is powered alone draws current; or ""."""
        alone = [] if self.trusted or event.rests else [each for each, _ in event.drew if each in self._asked]
        return _DEAF.format(alone[0]) if alone else ""  # mutants accepted (Step): any of them

    def take(self, event: PowerSeen, now_ns: int) -> list[Effect]:
        legs, deaf = self._legs, self._deaf(event)
        self.alive, self._blocked = event.alive, {each: f"{why}; a reset feeds it again" for each, why in event.refused}
        self.down = None if event.alive else Down(SILENT, None)
        self._withheld |= dict.fromkeys(legs.servos if deaf else (), deaf)
        self._withheld |= {servo_id: _DREW for servo_id, _ in event.drew if not deaf}
        self._withheld |= dict.fromkeys(event.taken - self._blocked.keys(), _TAKEN)  # such as by `stop-servos`
        self.trusted = self.trusted or event.rests
        if event.lost - event.taken - self._blocked.keys():  # a silence, perhaps over by now: it may have restarted
            self.trusted = self._rules.angles_first
        legs.gates.supply.fed = event.fed if self.trusted else frozenset()
        effects: list[Effect] = []
        if self._cut and not event.supplied.isdisjoint(self._asked):
            self._cut = False
            effects = [Announce(Kind.POWER_RESTORED, "the power board feeds servos again")]
        if not (legs.sends and event.alive):
            return effects
        refused = self._withheld | self._blocked
        lost = legs_of(each for each in (*event.lost, *refused) if legs.servos[each].will_run)
        stopped = self._stop(lost, "the power board does not feed it any more", now_ns)
        return [*stopped, *legs.start_fed(now_ns), *effects]

    def reset(self) -> list[Effect]:
        """Allow all servos to be powered again, after an accepted reset."""
        self._withheld.clear()
        return [ClearErrors()]

    def _stop(self, unfed: Collection[int], detail: str, now_ns: int) -> list[Effect]:
        """Stop these legs, or all six if the robot only stops as a whole."""
        legs = self._legs
        due = dict.fromkeys(legs.by_number if unfed and self._rules.stops_whole else sorted(unfed))
        return legs.stop(due, Halt(Cause.WATCHDOG, Reason.NO_POWER, detail), now_ns) if due else []

    # ---- what is powered

    def supply(self, effects: list[Effect], mode: Mode, estop: int, *, outside: bool) -> list[Effect]:
        """End a step: return its effects with its cuts before them, and its feeds after them.

        `estop` is the number of the newest emergency stop; `outside`: `stop-servos` is at work.
        """
        why, before = _WHY.get(mode), self._asked
        if outside:  # `stop-servos` cuts power even if nothing shows it
            self._withheld |= dict.fromkeys(before, _TAKEN)
        self.closed = not self.alive or bool(self._withheld or self._blocked)
        if why or outside or not self.alive:
            self.trusted = self._rules.angles_first
        everything = why is not None and (why, estop) != self._cause  # others may have fed some
        self._cause = why, estop
        to_feed = self._legs.to_feed()
        keep = before.keys() & to_feed
        wanted = to_feed.keys() - self._withheld.keys() - self._blocked.keys()
        if wanted and not self.trusted:
            wanted = wanted & keep or {min(wanted)}
        self._asked = {each: to_feed[each] for each in to_feed if each in wanted}
        if everything or keep != before.keys():
            effects = [Cut(frozenset(keep), everything), *effects]
        if self._asked != before:
            effects = [*effects, Feed(self._asked)]
        if why and before:
            self._cut = True
            effects = [*effects, Announce(Kind.POWER_CUT, f"the servos' supply is cut, {why}", legs=ALL_LEGS)]
        return effects
