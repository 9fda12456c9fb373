"""The part of the oracle (`oracle.py`) that is about the lease, the buttons, and messages without a time."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import ButtonRequest, Command, Effect, LeaseRequest
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from schemas.words import Kind, Reason
from tests.support.history import announced, demand, judge_answer

MOST_ASKERS = 8
_LEASE_KINDS = frozenset({Kind.LEASE_ACQUIRED, Kind.LEASE_RELEASED, Kind.LEASE_TAKEN, Kind.LEASE_ASKED})


class LeaseHistory:
    """Who holds the lease and until when, who may acquire it after a handover, and who has asked."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.token: str | None = None
        """The token in force."""
        self.old_token: str | None = None
        """The latest that is not good any more."""
        self.holder: str | None = None
        self.due_ns: int | None = None
        self.askers: tuple[str, ...] = ()
        self.is_new = False
        """Whether somebody has acquired the lease in this step."""

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what still matters; one token is as good as another."""
        left_ns = None if self.due_ns is None else self.due_ns - now_ns
        return self.holder, self.token is not None, self.old_token is not None, left_ns, self.askers

    def end(self) -> None:
        """Free the lease."""
        self._give(None, None, None)

    def _give(self, holder: str | None, token: str | None, now_ns: int | None) -> None:
        self.old_token = self.token or self.old_token
        self.holder, self.token, self.askers = holder, token, ()
        self.due_ns = None if now_ns is None else now_ns + self.rules.lease_ttl_ns

    # ---- time and commands

    def pass_time(self, now_ns: int, effects: Sequence[Effect]) -> None:
        """End the lease of a holder that is silent for the ttl, and demand that this is announced once."""
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
        """Record that a command with this token was accepted."""
        if token is not None and token == self.token:
            self.due_ns = now_ns + self.rules.lease_ttl_ns

    # ---- requests

    def judge(self, request: LeaseRequest, now_ns: int, effects: Sequence[Effect], *, ended: bool) -> bool:
        """Judge the answer to a request, and the event about it. Return whether all legs must be stopped by it."""
        reason, kind = (Reason.STOPPING, None) if ended else self._outcome(request)
        judge_answer(request, effects, reason, request.fresh_token if request.do in ("acquire", "take") else None)
        by = self.holder if request.do == "release" else request.source
        if kind is not None and reason is None:
            events = [(each.kind, each.source) for each in announced(effects, _LEASE_KINDS)]
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


MOST_OF_ONE = 4
MOST_UNPROVED = 16
DRIFT = 5000
"""The clocks may drift apart by one nanosecond in this many: 200 ppm."""
_BUTTON_KINDS = frozenset({Kind.BUTTON_REGISTERED, Kind.BUTTON_LEFT, Kind.BUTTON_RETURNED})


@dataclass(frozen=True, slots=True)
class ButtonHistory:
    """One registration; `least_ns` is the smallest difference of the two clocks that a message has shown, and what its
    clock may have lost since; `floor_ns` is without that."""

    name: str
    holder: str | None = None
    counts: bool = True
    count: int = -1
    until_ns: int | None = None
    silent: bool = False
    least_ns: int | None = None
    floor_ns: int = 0
    newest_ns: int = 0
    """When a message last showed one; since then their clocks may have drifted apart by `DRIFT`."""


class ButtonsHistory:
    """The registered buttons, and until when each is alive."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.known: dict[str, ButtonHistory] = {}
        self.old_token: str | None = None
        """The latest that is not good any more."""
        self.fell_ns: int | None = None

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what still matters; one token is as good as another, and so is a count."""
        each = tuple(
            (
                button.name,
                button.holder,
                button.counts,
                button.until_ns and button.until_ns - now_ns,
                button.silent,
                button.least_ns,
                button.floor_ns,
                button.count < 0,
            )
            for button in self.known.values()
        )
        return each, self.old_token is not None

    @property
    def alive(self) -> int:
        """Return how many certificates have a live button that counts; without proof, how many names."""
        who = [each for each in self.known.values() if each.until_ns is not None and each.counts]
        proved = {each.holder for each in who if each.holder is not None}
        return len(proved) + len([each for each in who if each.holder is None])

    @property
    def closed(self) -> bool:
        """Return whether fewer are alive than are required."""
        return self.alive < self.rules.buttons_required

    @property
    def due_ns(self) -> int | None:
        return min((each.until_ns for each in self.known.values() if each.until_ns is not None), default=None)

    # ---- time

    def pass_time(self, now_ns: int, effects: Sequence[Effect]) -> None:
        """End the buttons without a check-in for the timeout, and demand that each is announced once, in order."""
        late = [(button.until_ns, token) for token, button in self.known.items() if button.until_ns is not None]
        late = sorted((each for each in late if now_ns >= each[0]), key=lambda each: each[0])
        silent = [each.source for each in announced(effects, {Kind.BUTTON_SILENT})]
        demand(
            silent == [self.known[token].name for _, token in late], f"a button without a check-in is silent: {silent}"
        )
        for until_ns, token in late:
            self._change(token, replace(self.known[token], until_ns=None, silent=True), until_ns)

    def _change(self, token: str, button: ButtonHistory | None, now_ns: int) -> None:
        closed = self.closed
        if button is None:
            self.old_token = token
            del self.known[token]
        else:
            self.known[token] = button
        if self.closed and not closed:
            self.fell_ns = now_ns

    # ---- requests

    def judge(self, request: ButtonRequest, now_ns: int, effects: Sequence[Effect], *, ended: bool) -> None:
        """Judge the answer to a request, and the event announced about it."""
        reason, event = (Reason.STOPPING, None) if ended else self._outcome(request, now_ns)
        judge_answer(request, effects, reason, request.fresh_token if request.do == "register" else None)
        kinds = [(each.kind, each.source) for each in announced(effects, _BUTTON_KINDS)]
        demand(kinds == ([] if event is None else [event]), f"{request.do}: {event} is announced, not {kinds}")

    def _outcome(self, request: ButtonRequest, now_ns: int) -> tuple[Reason | None, tuple[Kind, str] | None]:
        if request.do == "register":
            return self._registered(request, now_ns)
        button = self.known.get(request.token)
        if button is None:
            return Reason.UNKNOWN_BUTTON, None
        if request.do == "leave":
            self._change(request.token, None, now_ns)
            return None, (Kind.BUTTON_LEFT, button.name)
        if request.count <= button.count:
            return Reason.STALE, None
        button = replace(button, count=request.count)
        came_ns = request.received_ns
        if request.sent_ms is not None:
            away_ns = came_ns - round(request.sent_ms * NS_PER_MS)
            drift_ns = (came_ns - button.newest_ns) // DRIFT
            floor_ns = away_ns if button.least_ns is None else min(away_ns, button.floor_ns)
            most_ns = floor_ns + self.rules.buttons_timeout_ns // 4
            least_ns = away_ns if button.least_ns is None else min(away_ns, button.least_ns + drift_ns, most_ns)
            button = replace(button, least_ns=least_ns, floor_ns=floor_ns, newest_ns=request.received_ns)
            came_ns -= away_ns - least_ns
        until_ns = came_ns + self.rules.buttons_timeout_ns
        if until_ns <= now_ns:
            self._change(request.token, button, now_ns)
            return Reason.STALE, None
        back = (Kind.BUTTON_RETURNED, button.name) if button.silent else None
        button = replace(button, silent=False, until_ns=max(until_ns, button.until_ns or 0))
        self._change(request.token, button, now_ns)
        return None, back

    def _registered(self, request: ButtonRequest, now_ns: int) -> tuple[Reason | None, tuple[Kind, str] | None]:
        name = request.source or ""
        mine = [(token, button) for token, button in self.known.items() if button.holder == request.holder]
        older = [each for each in mine if each[1].name == name]
        until_ns = older[0][1].until_ns if older else None
        if not older and len(mine) == (MOST_UNPROVED if request.holder is None else MOST_OF_ONE):
            older = [each for each in mine if each[1].until_ns is None][:1]
            if not older:
                return Reason.BUTTON_DENIED, None
        least_ns = None if request.sent_ms is None else request.received_ns - round(request.sent_ms * NS_PER_MS)
        fresh = ButtonHistory(name, request.holder, request.counts, until_ns=until_ns, newest_ns=request.received_ns)
        for token, _ in older:
            self.old_token = token
            del self.known[token]
        self._change(request.fresh_token, replace(fresh, least_ns=least_ns, floor_ns=least_ns or 0), now_ns)
        return None, (Kind.BUTTON_REGISTERED, name)


LONG_AGO_NS = -(10**9)


class Rhythm(NamedTuple):
    """One key's messages since it was last quiet."""

    first_ns: int
    last_ns: int
    instant_ns: int
    messages: int
    score: int
    servos: frozenset[int]
    """The servos that they start or set."""

    def key(self, now_ns: int, rules: Rules) -> tuple[object, ...]:
        """Return what still matters."""
        young_ns = max(0, self.first_ns + rules.start_wait_ns - now_ns)
        apart_ns = max(0, self.instant_ns + rules.apart_ns - now_ns)
        return young_ns, now_ns - self.last_ns, apart_ns, min(self.messages, 4), self.score, self.servos


@dataclass(slots=True)
class BacklogHistory:
    """The messages without a time on each key, and since when servos' starts wait for later ones."""

    rules: Rules
    rhythms: dict[str, Rhythm] = field(default_factory=dict)
    waiting_ns: dict[int, int] = field(default_factory=dict)
    taken_ns: dict[int, int] = field(default_factory=dict)
    """When the newest command for such a start was accepted: it is not rejected in the same step."""

    def clone(self) -> Self:
        """Return a copy."""
        changed = dict(self.rhythms), dict(self.waiting_ns), dict(self.taken_ns)
        return type(self)(self.rules, *changed)

    def comes(self, command: Command, instant_ns: int, now_ns: int) -> None:
        """Take a command's message into account."""
        if not self.rules.start_wait_ns or command.sent_ms is not None or not command.moves or command.rejected:
            return
        old = self.rhythms.get(command.key)
        if old is None or now_ns - old.last_ns >= self.rules.quiet_ns:
            old = Rhythm(now_ns, now_ns, LONG_AGO_NS, 0, 0, frozenset())
        apart_ns = instant_ns - old.instant_ns
        alone = apart_ns > 0 if command.verb is Verb.GET else apart_ns >= self.rules.apart_ns
        score = max(old.score - 1, 0) if alone else min(old.score + 3, self.rules.most_clumped)
        servos = old.servos | {servo_id for servo_id, _ in command.moves}
        self.rhythms[command.key] = Rhythm(old.first_ns, now_ns, instant_ns, old.messages + 1, score, servos)

    def begins(self, servo_id: int, command: Command, now_ns: int, *, waits: bool) -> None:
        """Let an accepted start or set of a servo that does not run wait; `waits`: an earlier start of it does."""
        earlier_ns = self.waiting_ns.pop(servo_id, now_ns - self.rules.silence_ns)
        since_ns = earlier_ns if waits else now_ns
        if self.rules.start_wait_ns and command.sent_ms is None:
            self.waiting_ns[servo_id], self.taken_ns[servo_id] = since_ns, now_ns
            if self.verdict(servo_id, now_ns) is True:
                del self.waiting_ns[servo_id]

    def verdict(self, servo_id: int, now_ns: int) -> bool | int:
        """Return whether the servo's start leaves (True) or is rejected (False), or when to look again."""
        since_ns = self.waiting_ns.get(servo_id)
        if since_ns is None:
            return True
        rules = self.rules
        known = [each for each in self.rhythms.values() if servo_id in each.servos or rules.starts_whole]
        known = [each for each in known if now_ns < each.last_ns + rules.quiet_ns]
        others = [each for each in known if each.last_ns > since_ns]
        least_ns = since_ns + (rules.silence_ns if others else rules.start_wait_ns)
        least_ns = max([least_ns, *(each.first_ns + rules.start_wait_ns for each in known)])
        clumps = [each for each in known if each.score > 0]
        silent_ns = max((each.last_ns + rules.silence_ns for each in clumps), default=now_ns)
        last_ns = max(min(silent_ns, since_ns + rules.proof_ns), self.taken_ns[servo_id] + 1)
        if now_ns < least_ns:
            return max(least_ns, last_ns) if clumps else least_ns
        if not clumps or (silent_ns <= now_ns and max(each.messages for each in clumps) <= 3):
            return True
        return last_ns if now_ns < last_ns else False

    def key(self, now_ns: int, waiting: Iterable[int]) -> tuple[object, ...]:
        """Return what still matters of it, if these servos wait to be started."""
        rhythms = ((name, each) for name, each in self.rhythms.items() if now_ns < each.last_ns + self.rules.quiet_ns)
        held = tuple(
            (servo_id, now_ns - self.waiting_ns[servo_id], self.taken_ns[servo_id] == now_ns)
            for servo_id in waiting
            if servo_id in self.waiting_ns
        )
        return tuple(sorted((name, *each.key(now_ns, self.rules)) for name, each in rhythms)), held
