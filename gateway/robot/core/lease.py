"""The lease: one driver for the whole robot. Pure: the time, and the tokens' randomness, are arguments.

The rules (docs/interface.md, Behaviour *Lease*), by state:

- Free: everyone may acquire it. Commands need no token, unless the lease is required.
- Held: moves and resets need the holder's token. The lease expires `ttl_ns` after the holder's last renewal or accepted
  command. Deadlines precede a command of the same step.
- Asked: held, and others have asked for it. The latest `MOST_ASKERS` are known; the holder may hand over to each.
- Handed over: reserved for one of them for `ttl_ns`. No other client can acquire it, and no token is valid.

A takeover succeeds in every state; the supervisor stops all legs first. A token is valid as long as its lease. Later
it is rejected in every state, since commands of its holder may still be on their way. Stops, deletes and emergency
stops need no token.
"""

import hmac
from typing import Any, Final

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import Announce, Calibrate, Command, Effect, LeaseRequest, RequestAnswer, Reset
from gateway.robot.core.interlock import Interlock, Why
from gateway.robot.core.legs import Halt, Legs
from gateway.robot.core.rules import Rules
from schemas import keys
from schemas.words import Cause, Kind, Reason

MOST_ASKERS: Final = 8
"""More people than drive one robot; a ninth replaces the first."""


class RobotLease(Interlock[LeaseRequest]):
    """The lease of one robot: its holder, its token, and the clients that have asked for it."""

    takes = (LeaseRequest,)
    bars = (Command, Reset, Calibrate)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self._askers: tuple[str, ...] = ()
        """The clients that have asked, in this order."""
        self.end()

    @property
    def _handed_over(self) -> bool:
        """Whether the lease waits for `holder` to acquire it."""
        return self.holder is not None and self._token is None

    @property
    def asked_by(self) -> str | None:
        """The client that asked for the lease last, or None."""
        return self._askers[-1] if self._askers else None

    # ---- commands

    def why_not(self, request: Any) -> Why | None:
        token = request.lease
        if self._token is not None:
            if token is not None and hmac.compare_digest(token, self._token):
                return None
            lost = "" if token is None else "the command's own lease has ended, and "
            return Reason.NOT_HOLDER, f"{lost}{self.holder} holds the lease"
        if self.holder is not None:
            return Reason.NOT_HOLDER, f"the lease is handed over to {self.holder}, who has not acquired it yet"
        if token is not None:
            return Reason.NOT_HOLDER, "the command's own lease has ended; acquire it again"
        if self._rules.lease_required and type(request) is not Reset:
            return Reason.NO_LEASE, "nobody holds the lease, and lease.required is set; acquire it first"
        return None

    def record_use(self, token: str, now_ns: int) -> None:
        """Renew the lease for an accepted command with the holder's token."""
        if self.holds(token):
            self.due_ns = now_ns + self._rules.lease_ttl_ns

    # ---- time

    def expire(self, now_ns: int) -> list[Effect]:  # noqa: ARG002
        ttl = f"{self._rules.lease_ttl_ns / NS_PER_MS:g} ms"
        if self._handed_over:
            detail = f"{self.holder} did not acquire the lease within {ttl} of its handover; it is free"
        else:
            detail = f"{self.holder} was silent for {ttl} and has lost the lease"
        announcement = Announce(Kind.LEASE_EXPIRED, detail, self.holder, source_id=self._holder_id)
        self.end()
        return [announcement]

    def end(self) -> None:
        """Free the lease."""
        self._give(None, None, None)

    # ---- requests

    def halts(self, event: LeaseRequest) -> Halt | None:
        taken = f"{event.source} has taken the lease"
        sender = event.source, event.source_id
        return Halt(Cause.COMMAND, Reason.NOT_HOLDER, taken, sender) if event.do == "take" else None

    def take(self, event: LeaseRequest, now_ns: int) -> list[Effect]:
        """Handle one request. Return its effects; the last one is its answer."""
        why_not = self._why_not_granted(event)
        if why_not is not None:
            return [RequestAnswer(*why_not)]
        name, holder, to = event.source or "", self.holder, event.to
        kind, who, who_id = Kind.LEASE_RELEASED, holder, self._holder_id
        match event.do:
            case "acquire" | "take":
                return self._acquired(event, now_ns)
            case "renew":
                self.due_ns = now_ns + self._rules.lease_ttl_ns
                return [RequestAnswer()]
            case "ask":
                others = [each for each in self._askers if each != name]
                self._askers = (*others, name)[-MOST_ASKERS:]
                kind, who, who_id = Kind.LEASE_ASKED, name, event.source_id
                detail = f"{name} asks {holder} for the lease"
            case "release" if to is not None:
                self._give(to, None, now_ns)
                detail = f"{holder} has handed the lease over to {to}"
            case "release":
                self.end()
                detail = f"{holder} has released the lease"
        return [Announce(kind, detail, who, keys.LEASE, source_id=who_id), RequestAnswer()]

    def _why_not_granted(self, request: LeaseRequest) -> Why | None:
        match request.do:
            case "acquire" if self.holder is not None and not (self._handed_over and request.source == self.holder):
                where = "handed over to" if self._handed_over else "held by"
                return Reason.LEASE_HELD, f"the lease is {where} {self.holder}"
            case "ask" if self.holder is None:
                return Reason.NO_LEASE, "nobody holds the lease; acquire it"
            case "ask" if self._handed_over:
                return Reason.LEASE_HELD, f"the lease is handed over to {self.holder}"
            case "renew" | "release" if not self.holds(request.token):
                return Reason.NOT_HOLDER, "this is not the token of the current lease"
            case "release" if request.to is not None and request.to not in self._askers:
                return Reason.LEASE_DENIED, f"{request.to} has not asked for the lease"
        return None

    def _acquired(self, request: LeaseRequest, now_ns: int) -> list[Effect]:
        legs, name, before, taken = self._legs, request.source, self.holder, request.do == "take"
        self._give(name, request.fresh_token, now_ns, request.source_id)
        # Others' waiting commands must not move the robot under the new holder.
        dropped = legs.drop(legs.servos.values(), Reason.NOT_HOLDER, f"{name} has acquired the lease")
        kind = Kind.LEASE_TAKEN if taken and before is not None else Kind.LEASE_ACQUIRED
        what = "acquired the lease" if kind is Kind.LEASE_ACQUIRED else f"taken the lease from {before}"
        done = "all six legs are stopped" if taken and legs.sends else ""
        change = Announce(kind, f"{name} has {what}", name, keys.LEASE, done=done, source_id=request.source_id)
        return [*dropped, change, RequestAnswer(token=self._token)]

    # ----

    def holds(self, token: str | None) -> bool:
        """Return whether this is the holder's token. May be called from any thread."""
        return self._token is not None and token is not None and hmac.compare_digest(token, self._token)

    def _give(self, holder: str | None, token: str | None, now_ns: int | None, source_id: str | None = None) -> None:
        """Assign the lease to a holder, reserve it for a nominee (no token), or free it."""
        self.holder = holder
        """The holder, or the nominee of a handover."""
        self._holder_id = source_id
        self._token = token
        self.since_ns = None if token is None else now_ns
        """When its holder acquired it; None while it is free or handed over."""
        self.due_ns = None if now_ns is None else now_ns + self._rules.lease_ttl_ns
        """When the lease, or the handover, expires; None while it is free."""
        self._askers = ()
        self.closed = holder is not None or self._rules.lease_required
        """Whether commands need a token. If not, only commands with a token are checked."""
