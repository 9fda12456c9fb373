"""What a judge of the supervisor remembers of the lease, and what it demands of each request; see `oracle.py`."""

from collections.abc import Sequence

from gateway.robot.core.events import Effect, LeaseRequest
from gateway.robot.core.rules import Rules
from schemas.telemetry import Kind, Reason
from tests.support.history import announced, demand, judge_answer

MOST_ASKERS = 8
_KINDS = frozenset({Kind.LEASE_ACQUIRED, Kind.LEASE_RELEASED, Kind.LEASE_TAKEN, Kind.LEASE_ASKED})


class LeaseHistory:
    """Who holds the lease and until when, who may acquire it after a handover, and who has asked."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.token: str | None = None
        """The one that is good now."""
        self.old_token: str | None = None
        """The latest that is not good any more."""
        self.holder: str | None = None
        self.due_ns: int | None = None
        self.askers: tuple[str, ...] = ()
        self.is_new = False
        """Whether somebody has acquired it in this step."""

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what of it still matters; one token is as good as another."""
        left_ns = None if self.due_ns is None else self.due_ns - now_ns
        return self.holder, self.token is not None, self.old_token is not None, left_ns, self.askers

    def end(self) -> None:
        """It is free."""
        self._give(None, None, None)

    def _give(self, holder: str | None, token: str | None, now_ns: int | None) -> None:
        self.old_token = self.token or self.old_token
        self.holder, self.token, self.askers = holder, token, ()
        self.due_ns = None if now_ns is None else now_ns + self.rules.lease_ttl_ns

    # ---- time and commands

    def pass_time(self, now_ns: int, effects: Sequence[Effect]) -> None:
        """A holder that is silent for the ttl loses the lease, which is announced once."""
        self.is_new = False
        late = self.due_ns is not None and now_ns >= self.due_ns
        expired = [each.source for each in announced(effects, {Kind.LEASE_EXPIRED})]
        demand(expired == ([self.holder] if late else []), "a holder that falls silent loses the lease in its ttl")
        if late:
            self.end()

    def reason_to_reject(self, token: str | None, *, reset: bool = False) -> Reason | None:
        """Return why a request that moves, or a reset, is rejected with this token; None: it is not."""
        if token is None:
            if self.holder is not None:
                return Reason.NOT_HOLDER
            return Reason.NO_LEASE if self.rules.lease_required and not reset else None
        return None if token == self.token else Reason.NOT_HOLDER

    def record_use(self, token: str | None, now_ns: int) -> None:
        """A command with this token was accepted."""
        if token is not None and token == self.token:
            self.due_ns = now_ns + self.rules.lease_ttl_ns

    # ---- requests

    def judge(self, request: LeaseRequest, now_ns: int, effects: Sequence[Effect], *, ended: bool) -> bool:
        """Judge the answer to a request, and the event about it. Return whether all legs must be stopped by it."""
        reason, kind = (Reason.STOPPING, None) if ended else self._outcome(request)
        judge_answer(request, effects, reason, request.fresh_token if request.do in ("acquire", "take") else None)
        by = self.holder if request.do == "release" else request.source
        if kind is not None and reason is None:
            events = [(each.kind, each.source) for each in announced(effects, _KINDS)]
            demand(events == [(kind, by)], f"a change of the lease is announced once: {events}")
        if reason is None:
            self._carry_out(request, now_ns)
        return reason is None and request.do == "take"

    def _outcome(self, request: LeaseRequest) -> tuple[Reason | None, Kind | None]:
        """Return why the request must be rejected, or the event about it."""
        reason, kind = None, None
        free, handed_over = self.holder is None, self.holder is not None and self.token is None
        match request.do:
            case "acquire":
                kind = Kind.LEASE_ACQUIRED
                if not free and not (handed_over and request.source == self.holder):
                    reason = Reason.LEASE_HELD
            case "take":
                kind = Kind.LEASE_ACQUIRED if free else Kind.LEASE_TAKEN
            case "ask":
                kind = Kind.LEASE_ASKED
                if self.token is None:
                    reason = Reason.LEASE_HELD if handed_over else Reason.NO_LEASE
            case "renew" | "release":
                kind = Kind.LEASE_RELEASED if request.do == "release" else None
                if request.token is None or request.token != self.token:
                    reason = Reason.NOT_HOLDER
                elif request.to is not None and request.to not in self.askers:
                    reason = Reason.LEASE_DENIED
        return reason, kind

    def _carry_out(self, request: LeaseRequest, now_ns: int) -> None:
        match request.do:
            case "acquire" | "take":
                self._give(request.source, request.fresh_token, now_ns)
                self.is_new = True
            case "ask":
                others = tuple(name for name in self.askers if name != request.source)
                self.askers = (*others, request.source or "")[-MOST_ASKERS:]
            case "renew":
                self.due_ns = now_ns + self.rules.lease_ttl_ns
            case "release":
                self._give(request.to, None, now_ns if request.to is not None else None)
