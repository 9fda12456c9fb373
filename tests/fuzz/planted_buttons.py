"""Stop buttons with a bug each, for the model check to find."""

from dataclasses import replace

from gateway.robot.core.buttons import Button, Buttons, Outcome
from gateway.robot.core.events import BusFailed, ButtonDo, ButtonRequest, Command, Effect, Event
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Reason


def with_buttons(buttons: type[Buttons]) -> type[Supervisor]:
    """A supervisor with other buttons."""

    class Planted(Supervisor):
        def __init__(self, rules: Rules) -> None:
            super().__init__(rules)
            self.buttons = buttons(rules)

    return Planted


class NeverSilent(Buttons):
    """A button that has checked in once is alive for good."""

    def expire(self, now_ns: int, then: str = "") -> list[Effect]:
        del then
        self.due_ns = None if self.due_ns is None else max(self.due_ns, now_ns + 1)
        return []


class SilentLate(Buttons):
    """A check-in of the step in which a button falls silent saves it."""

    def expire(self, now_ns: int, then: str = "") -> list[Effect]:
        return super().expire(now_ns - 1, then)


class CountsWhenItComes(Buttons):
    """A check-in that was held back counts from its arrival."""

    def grant(self, request: ButtonRequest, now_ns: int, then: str = "") -> Outcome:
        return super().grant(replace(request, sent_ms=None), now_ns, then)


class RegistrationTellsNoTime(Buttons):
    """The first check-in is taken as one that was not held back."""

    def grant(self, request: ButtonRequest, now_ns: int, then: str = "") -> Outcome:
        if request.do is ButtonDo.REGISTER:
            request = replace(request, sent_ms=None)
        return super().grant(request, now_ns, then)


class CountsAgain(Buttons):
    """A check-in that is sent again counts again."""

    def grant(self, request: ButtonRequest, now_ns: int, then: str = "") -> Outcome:
        if request.token in self._by_token:
            self._by_token[request.token].count = -1
        return super().grant(request, now_ns, then)


class AliveOnceRegistered(Buttons):
    """Who registers counts before the first check-in."""

    def grant(self, request: ButtonRequest, now_ns: int, then: str = "") -> Outcome:
        outcome = super().grant(request, now_ns, then)
        if request.do is ButtonDo.REGISTER and request.fresh_token in self._by_token:
            self._by_token[request.fresh_token].until_ns = now_ns + self._timeout_ns
            self._look(now_ns)
        return outcome


class OlderOneLivesOn(Buttons):
    """Two buttons of one name count as two."""

    def grant(self, request: ButtonRequest, now_ns: int, then: str = "") -> Outcome:
        kept: dict[str, Button] = dict(self._by_token)
        outcome = super().grant(request, now_ns, then)
        if request.do is ButtonDo.REGISTER:
            self._by_token.update({token: each for token, each in kept.items() if token not in self._by_token})
            self._look(now_ns)
        return outcome


class LeavesUnnoticed(Buttons):
    """Who leaves goes on being counted."""

    def grant(self, request: ButtonRequest, now_ns: int, then: str = "") -> Outcome:
        closed, fell_ns = self.closed, self.fell_ns
        outcome = super().grant(request, now_ns, then)
        if request.do is ButtonDo.LEAVE:
            self.closed, self.fell_ns = closed, fell_ns
        return outcome


class OneTooFew(Buttons):
    """One button less than required is enough."""

    def _look(self, at_ns: int) -> bool:
        fell = super()._look(at_ns)
        self.closed = self.closed and self.alive < self._required - 1
        return fell


class RunsOnUnwatched(Supervisor):
    """What runs goes on when buttons are too few; only starts are rejected."""

    def _stop_unwatched(self, now_ns: int) -> list[Effect]:
        del now_ns
        return []


class StopsNeedAButton(Supervisor):
    """Nobody stops the robot while no button is alive."""

    def _rejection(self, command: Command) -> tuple[Reason, str] | None:
        return super()._rejection(command) or self._why_unwatched()


class ResetsUnwatched(Supervisor):
    """The emergency stop is left while nobody watches."""

    def _why_unwatched(self) -> tuple[Reason, str] | None:
        return None if self._latched_ns is not None else super()._why_unwatched()


class Oversleeps(Supervisor):
    """Wakes up for the legs and the lease only."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        effects = super().step(event, now_ns, instant_ns)
        self.due_ns = self.legs.due_ns if self._bus_ok else None
        return effects


class ForgetsThemInFault(Supervisor):
    """A bus fault ends all registrations, and nobody is told."""

    def _bus_failed(self, event: BusFailed) -> list[Effect]:
        self.buttons = Buttons(self._rules)
        return super()._bus_failed(event)


class LandsFromNow(Supervisor):
    """A landing that begins late is stopped late."""

    def _stop_unwatched(self, now_ns: int) -> list[Effect]:
        self.buttons.fell_ns = now_ns
        return super()._stop_unwatched(now_ns)
