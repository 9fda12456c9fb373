"""The contract of one rule that may keep the robot from moving, or bring it down. Pure.

A rule is a file with one such class, and a line in the supervisor's `ORDER`. The first that objects gives the reason.
"""

from typing import Any, Generic, NamedTuple, Self, TypeVar

from gateway.model.angle_limits import AngleLimits
from gateway.robot.core.events import Calibrate, Command, Effect, Event, Reset
from gateway.robot.core.leg import Rules
from gateway.robot.core.legs import Legs
from schemas.telemetry import Cause, Reason

Barred = Command | Reset | Calibrate
"""A request to which an interlock may object."""
Why = tuple[Reason, str]
Own = TypeVar("Own")
"""The events that an interlock takes."""


class Halt(NamedTuple):
    """All six legs are stopped at once, and what waits is rejected."""

    cause: Cause
    reason: Reason
    detail: str


class Down(NamedTuple):
    """Nothing may run: what runs lands until `landing_ns` after `since_ns` (None: now), or is stopped."""

    why: str
    since_ns: int | None
    reason: Reason
    detail: str


class Interlock(Generic[Own]):
    """One rule, and the events that it takes. One owner, one thread."""

    takes: tuple[type[Event], ...] = ()
    """The events that it takes."""
    bars: tuple[type[Barred], ...] = (Command,)
    """The requests to which it may object; to a command only if that starts or sets a servo."""
    closed = False
    """Whether it may object. `why_not` is asked only then."""
    down: Down | None = None
    """Why nothing may run; None: it may."""
    due_ns: int | None = None
    """When `expire` is due; None: never."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules

    @classmethod
    def of(cls, rules: Rules, limits: AngleLimits) -> Self:  # noqa: ARG003
        """Return the interlock of a robot with these rules and angle limits."""
        return cls(rules)

    def why_not(self, request: Any, legs: Legs) -> Why | None:  # noqa: ARG002
        """Return why `request` takes no effect, or None if it may."""
        return None

    def expire(self, now_ns: int, legs: Legs) -> list[Effect]:  # noqa: ARG002
        """Do what is due once `now_ns` (monotonic) has reached `due_ns`. Return the effects."""
        return []

    def overdue(self, now_ns: int, legs: Legs) -> list[Effect]:  # noqa: ARG002
        """Return the effects of a leg's deadline that has come."""
        return []

    def halts(self, event: Own) -> Halt | None:  # noqa: ARG002
        """Return the stop of all legs that precedes `take` of this event, or None. Deadlines due then are void."""
        return None

    def take(self, event: Own, now_ns: int, legs: Legs) -> list[Effect]:
        """Take one of its events, and return the effects."""
        raise NotImplementedError


def nothing_to_stop(legs: Legs) -> bool:
    """Return whether all legs are stopped, the robot lands already, or the bus is at fault."""
    return not legs.sends or legs.landing is not None or not any(leg.armed for leg in legs)


def how_it_comes_down(legs: Legs, rules: Rules) -> str:
    """Return an event's words for how the robot comes down in this step, or "" if nothing is to be stopped."""
    if nothing_to_stop(legs):
        return ""
    return "the robot lands" if rules.landing_ns and legs.running else "all six legs are stopped"
