"""Leases with a bug each, for the model check to find."""

from gateway.robot.core.events import BusFailed, Command, Do, Effect, Event, LeaseAnswer, LeaseRequest
from gateway.robot.core.lease import Lease, LeaseState
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Cause, Reason


def with_lease(lease: type[Lease]) -> type[Supervisor]:
    """A supervisor with another lease."""

    class Planted(Supervisor):
        def __init__(self, rules: Rules) -> None:
            super().__init__(rules)
            self.lease = lease(rules)

    return Planted


class OldTokensStillMove(Lease):
    """While the lease is free, a command that carries a token is taken as one without."""

    def rejection(self, token: str | None, *, reset: bool = False) -> tuple[Reason, str] | None:
        return super().rejection(None if self.state is LeaseState.FREE else token, reset=reset)


class AnyTokenMoves(Lease):
    """A token is looked at, but not compared."""

    def rejection(self, token: str | None, *, reset: bool = False) -> tuple[Reason, str] | None:
        if token is not None and self._token is not None:
            return None
        return super().rejection(token, reset=reset)


class FormerHolderDrivesOn(Lease):
    """Who was taken over keeps the token, and the new holder gets it, too."""

    def grant(self, request: LeaseRequest, now_ns: int) -> tuple[list[Effect], LeaseAnswer]:
        before = self._token
        told, answer = super().grant(request, now_ns)
        if request.do is Do.TAKE and before is not None and answer.reason is None:
            self._token = before
        return told, answer


class HandedOverToAnybody(Lease):
    """Whoever is first acquires what was handed over to another."""

    def grant(self, request: LeaseRequest, now_ns: int) -> tuple[list[Effect], LeaseAnswer]:
        if request.do is Do.ACQUIRE and self.state is LeaseState.HANDED_OVER:
            self.holder = request.source
        return super().grant(request, now_ns)


class AnyStopKeepsIt(Lease):
    """Whatever command is accepted renews the lease, whosever it is."""

    def heard(self, token: str, now_ns: int) -> None:
        super().heard(self._token or token, now_ns)


class NeverExpires(Lease):
    """A holder that falls silent keeps it."""

    def expire(self, now_ns: int) -> list[Effect]:
        self.due_ns = None if self.due_ns is None else max(self.due_ns, now_ns + 1)
        return []


class ExpiresLate(Lease):
    """A command of the step in which it would have expired saves it."""

    def expire(self, now_ns: int) -> list[Effect]:
        return super().expire(now_ns - 1)


class OpenWhileHandedOver(Lease):
    """Between two drivers, anybody moves the robot."""

    def rejection(self, token: str | None, *, reset: bool = False) -> tuple[Reason, str] | None:
        return None if self.state is LeaseState.HANDED_OVER else super().rejection(token, reset=reset)


class TakenByTheWrongRule(Lease):
    """`takeover = "never"` is accepted and ignored."""

    def is_takeover(self, request: LeaseRequest) -> bool:
        return request.do is Do.TAKE


class TakesWithoutStops(Supervisor):
    """The legs run on under whoever takes the lease."""

    def _lease_request(self, request: LeaseRequest, now_ns: int) -> list[Effect]:
        effects = super()._lease_request(request, now_ns)
        return [effect for effect in effects if getattr(effect, "cause", None) is not Cause.COMMAND]


class StopsNeedTheLease(Supervisor):
    """Nobody but its driver can stop the robot."""

    def _rejection(self, command: Command) -> tuple[Reason, str] | None:
        if self.lease.guards or command.lease is not None:
            return super()._rejection(command) or self.lease.rejection(command.lease)
        return super()._rejection(command)


class OthersStartsWait(Supervisor):
    """What others had waiting moves under the new holder."""

    def _lease_request(self, request: LeaseRequest, now_ns: int) -> list[Effect]:
        if self._ended or self.lease.is_takeover(request):
            return super()._lease_request(request, now_ns)
        published, answer = self.lease.grant(request, now_ns)
        return [*published, answer]


class OversleepsTheLease(Supervisor):
    """Wakes up for the legs only."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        effects = super().step(event, now_ns, instant_ns)
        self.due_ns = self.legs.due_ns if self._bus_ok else None
        return effects


class LosesItInFault(Supervisor):
    """A bus fault ends the lease, and nobody is told."""

    def _bus_failed(self, event: BusFailed) -> list[Effect]:
        self.lease.end()
        return super()._bus_failed(event)
