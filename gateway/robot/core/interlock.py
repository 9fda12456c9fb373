"""The contract of a rule that may keep the robot from moving, or bring it down. Pure.

A rule is a file with one such class, and a line in the supervisor's `ORDER`.
"""

from typing import Any, Final, Generic, NamedTuple, TypeVar

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import Announce, Calibrate, Command, Effect, Event, Reset
from gateway.robot.core.legs import Halt, Legs
from gateway.robot.core.rules import Rules
from schemas.robot import LEGS
from schemas.words import Cause, Kind, Reason

Barred = Command | Reset | Calibrate
"""A request to which an interlock may object."""
Why = tuple[Reason, str]
ALL_LEGS: Final = tuple(LEGS)
Own = TypeVar("Own")
"""The events that an interlock takes."""


class Down(NamedTuple):
    """No servo may run: running ones land until `landing_ns` after `since_ns` (None: now), or are stopped."""

    why: str
    since_ns: int | None


class Interlock(Generic[Own]):
    """One rule, and the events that it takes. One owner, one thread."""

    takes: tuple[type[Event], ...] = ()
    bars: tuple[type[Barred], ...] = (Command,)
    """The requests to which it may object. A command that only stops is never barred."""
    closed = False
    """Whether it may object; only then `why_not` is called."""
    objection: Why
    """Why it rejects. A rule needs none if it has its own `why_not` and is never `down`."""
    down: Down | None = None
    """Why no servo may run, or None."""
    of_legs = False
    """Whether its deadlines are the legs', which `Legs.plan` knows. A halt voids these."""
    due_ns: int | None = None
    """Its own next deadline, or None."""

    def __init__(self, rules: Rules, legs: Legs) -> None:
        self._rules = rules
        self._legs = legs

    def why_not(self, request: Any) -> Why | None:  # noqa: ARG002
        """Return why `request` is rejected, or None."""
        return self.objection

    def expire(self, now_ns: int) -> list[Effect]:  # noqa: ARG002
        """Handle its deadlines, or the legs', that `now_ns` has reached. Return the effects."""
        return []

    def halts(self, event: Own) -> Halt | None:  # noqa: ARG002
        """Return the Halt of all six legs that precedes `take` of this event, or None. It voids due deadlines."""
        return None

    def take(self, event: Own, now_ns: int) -> list[Effect]:
        """Take one of its events, and return the effects."""
        raise NotImplementedError  # mutants accepted (Forget): nobody calls it

    def _how_it_comes_down(self) -> str:
        """Return how the robot comes down in this step, for an event's text.

        "": all legs are stopped, the robot lands already, or the bus is at fault.
        """
        legs = self._legs
        if not legs.sends or legs.landing_ends_ns is not None or not any(leg.armed for leg in legs):
            return ""
        return "the robot lands" if self._rules.landing_ns and legs.running else "all six legs are stopped"

    def bring_down(self, now_ns: int) -> list[Effect]:
        """If no servo may run, land the robot if a servo runs and time is left, else stop all six legs."""
        if self.down is None or not self._how_it_comes_down():
            return []
        why, since_ns = self.down
        since_ns = now_ns if since_ns is None else since_ns
        due, halt = dict.fromkeys(self._legs.by_number, since_ns), Halt(Cause.WATCHDOG, *self.objection)
        return self._land(why, since_ns, now_ns) or self._legs.stop(due, halt, now_ns)

    def _land(self, why: str, since_ns: int, now_ns: int) -> list[Effect]:
        """Begin a landing that counts from `since_ns` if a servo runs and time is left. Return its effects, or []."""
        ends_ns = since_ns + self._rules.landing_ns
        if now_ns >= ends_ns or not self._legs.running:
            return []
        dropped = self._legs.land(now_ns, ends_ns)
        done = f"the robot lands, and is stopped {self._rules.landing_ns / NS_PER_MS:g} ms later"
        return [*dropped, Announce(Kind.LANDING, why, legs=ALL_LEGS, done=done)]
