"""What a judge of the supervisor remembers of the buttons, and what it demands of each request; see `oracle.py`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import ButtonRequest, Effect
from gateway.robot.core.rules import Rules
from schemas.telemetry import Kind, Reason
from tests.support.history import announced, demand, judge_answer

MOST_OF_ONE = 4
MOST_UNPROVED = 16
DRIFT = 5000
"""A nanosecond in so many: 200 ppm."""
_KINDS = frozenset({Kind.BUTTON_REGISTERED, Kind.BUTTON_LEFT, Kind.BUTTON_RETURNED})


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
    """Which buttons are registered, and until when each is alive."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.known: dict[str, ButtonHistory] = {}
        self.old_token: str | None = None
        """The latest that is not good any more."""
        self.fell_ns: int | None = None

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what of it still matters; one token is as good as another, and so is a count."""
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
        """Return how many certificates have a button that counts; where nothing is proved, how many names."""
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
        """A button without a check-in for the timeout is silent. Each is announced once, in the order of their ends."""
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
        kinds = [(each.kind, each.source) for each in announced(effects, _KINDS)]
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
