"""The contract of a rule that may keep the robot from moving, or bring it down. Pure.

A rule is a file with one such class, and a line in the supervisor's `ORDER`.
"""

from typing import Any, Final, Generic, NamedTuple, TypeVar

from gateway.model.angle_limits import AngleLimits
from gateway.robot.core.events import Calibrate, Command, Effect, Event, Reset
from gateway.robot.core.leg import Rules
from gateway.robot.core.legs import Legs
from schemas.robot import LEGS
from schemas.telemetry import Cause, Reason

Barred = Command | Reset | Calibrate
"""A request to which an interlock may object."""
Why = tuple[Reason, str]
ALL_LEGS: Final = tuple(LEGS)
Own = TypeVar("Own")
"""The events that an interlock takes."""


class Halt(NamedTuple):
    """Stop all six legs at once, and reject waiting commands."""

    cause: Cause
    reason: Reason
    detail: str


class Down(NamedTuple):
    """No servo may run: running ones land until `landing_ns` after `since_ns` (None: now), or are stopped."""

    why: str
    since_ns: int | None
    reason: Reason
    detail: str


class Interlock(Generic[Own]):
    """One rule, and the events that it takes. One owner, one thread."""

    takes: tuple[type[Event], ...] = ()
    bars: tuple[type[Barred], ...] = (Command,)
    """The requests to which it may object. A command that only stops is never barred."""
    closed = False
    """Whether it may object; only then `why_not` is called."""
    down: Down | None = None
    """Why no servo may run, or None."""
    due_ns: int | None = None
    """When `expire` is due, or None."""

    def __init__(self, rules: Rules, limits: AngleLimits) -> None:  # noqa: ARG002
        self._rules = rules

    def why_not(self, request: Any, legs: Legs) -> Why | None:  # noqa: ARG002
        """Return why `request` is rejected, or None."""
        return None

    def expire(self, now_ns: int, legs: Legs) -> list[Effect]:  # noqa: ARG002
        """Handle its deadline `due_ns`, which `now_ns` has reached. Return the effects."""
        return []

    def overdue(self, now_ns: int, legs: Legs) -> list[Effect]:  # noqa: ARG002
        """Handle legs' deadlines that `now_ns` has reached. Return the effects."""
        return []

    def halts(self, event: Own) -> Halt | None:  # noqa: ARG002
        """Return the Halt that precedes `take` of this event, or None. A Halt voids due deadlines."""
        return None

    def take(self, event: Own, now_ns: int, legs: Legs) -> list[Effect]:
        """Take one of its events, and return the effects."""
        raise NotImplementedError


def nothing_to_stop(legs: Legs) -> bool:
    """Return whether all legs are stopped, the robot lands already, or the bus is at fault."""
    return not legs.sends or legs.landing is not None or not any(leg.armed for leg in legs)


def how_it_comes_down(legs: Legs, rules: Rules) -> str:
    """Return how the robot comes down in this step, for an event's text, or "" if nothing is to be stopped."""
    if nothing_to_stop(legs):
        return ""
    return "the robot lands" if rules.landing_ns and legs.running else "all six legs are stopped"
