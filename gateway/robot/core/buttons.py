"""Stop buttons, which are enabling devices: servos run only while enough of them check in. Pure: time is an argument.

The rules (docs/interface.md, Behaviour *Buttons*), for each button:

- Registered: it has its own token, and does not count yet.
- Alive: from its first check-in until `timeout_ns` after its latest one was sent. Deadlines precede a check-in of the
  same step, so a late check-in does not keep a button alive.
- Silent: after that. Its next check-in makes it alive again, and starts nothing.

A check-in has the token and a growing count, so none counts twice. With `sent_ms`, it counts from when it was sent: the
button's fastest message, registration included, shows the offset of its clock, and a later message's extra time is its
delay. Without `sent_ms` it counts from its arrival.

A registration belongs to the certificate that has proved its name. A new one of the same name and certificate replaces
the older one, and is alive for as long as that was; it never replaces another certificate's. Certificates are counted,
so one device with two names is no second person. Without proofs, names are counted, and share MOST_UNPROVED places.

While fewer than `buttons_required` are alive, the supervisor starts and sets nothing, and stops running servos.
"""

from dataclasses import dataclass
from typing import Final

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import Announce, ButtonRequest, Command, Effect, RequestAnswer, Reset
from gateway.robot.core.interlock import ALL_LEGS, Down, Interlock
from gateway.robot.core.legs import Legs
from gateway.robot.core.rules import Rules
from schemas import keys
from schemas.words import Kind, Reason

MOST_OF_ONE: Final = 4
"""Registrations of a certificate: a person's phone, tablet and laptop. One more replaces the oldest one not alive."""
MOST_UNPROVED: Final = 16
"""Registrations without a certificate: twice as many as can be required."""
DRIFT_PPM: Final = 200  # mutants accepted (Step): a rounded bound
"""How much slower than the gateway's a button's clock may run: twice the error of a bad crystal (as in `staleness`)."""
RISE: Final = 4
"""A button's clock may fall behind by the timeout divided by this, at most, since an attacker who delays check-ins ever
longer looks like a slow clock. A slower button must register again."""


@dataclass(slots=True)
class Registration:  # mutants accepted (Step): set before it is read; a nanosecond
    """One registered button, and the clock of its messages."""

    name: str
    holder: str | None
    """The certificate that has proved the name."""
    counts: bool
    """Whether it counts towards `buttons.required`."""
    until_ns: int | None
    """Until when it is alive; None: it has not checked in yet, or is silent."""
    source_id: str | None = None
    count: int = -1
    silent: bool = False
    offset_ns: int | None = None
    """The gateway's clock minus the button's, plus the transit time of its fastest message, as of `newest_ns`."""
    newest_ns: int = 0
    least_ns: int = 0
    """The smallest `offset_ns` of this registration."""

    def sent_ns(self, message: ButtonRequest, rules: Rules) -> int:
        """Return when a message of this button was sent, in ns of the gateway's clock: at the latest when received."""
        received_ns, rise_ns = message.received_ns, rules.buttons_timeout_ns // RISE
        if message.sent_ms is None:
            return received_ns
        offset_ns = received_ns - round(message.sent_ms * NS_PER_MS)
        if self.offset_ns is None:
            self.offset_ns = self.least_ns = offset_ns
        else:
            drift_ns = max(0, received_ns - self.newest_ns) * DRIFT_PPM // 1_000_000
            self.offset_ns = min(offset_ns, self.offset_ns + drift_ns, self.least_ns + rise_ns)
            self.least_ns = min(self.least_ns, self.offset_ns)
        self.newest_ns = received_ns
        return received_ns - (offset_ns - self.offset_ns)


class Buttons(Interlock[ButtonRequest]):
    """The buttons of one robot: registrations, check-ins and deadlines."""

    takes = (ButtonRequest,)
    bars = (Command, Reset)

    def __init__(self, rules: Rules, legs: Legs) -> None:
        super().__init__(rules, legs)
        self._by_token: dict[str, Registration] = {}
        self._count_alive(None)

    @property
    def names(self) -> tuple[str, ...]:
        """The buttons that are alive, in the order of registration."""
        return tuple(button.name for button in self._by_token.values() if button.until_ns is not None)

    def knows(self, token: str) -> bool:
        """Return whether a registration has this token. May be called from any thread."""
        return token in self._by_token

    # ---- time

    def expire(self, now_ns: int) -> list[Effect]:
        """Mark buttons as silent whose deadline has passed at `now_ns`. Return the events."""
        effects: list[Effect] = []
        while self.due_ns is not None and now_ns >= self.due_ns:
            at_ns = self.due_ns
            button = next(each for each in self._by_token.values() if each.until_ns == at_ns)
            button.until_ns, button.silent = None, True
            what = f"no check-in of the button {button.name} in {self._rules.buttons_timeout_ns / NS_PER_MS:g} ms"
            effects += self._changed(Kind.BUTTON_SILENT, what, button, at_ns, key=None)
        return effects

    # ---- requests

    def take(self, event: ButtonRequest, now_ns: int) -> list[Effect]:
        """Handle one request. Return its events, and its answer as the last effect."""
        if event.do == "register":
            return self._register(event, now_ns)
        button = self._by_token.get(event.token)
        if button is None:
            return [RequestAnswer(Reason.UNKNOWN_BUTTON, _UNKNOWN)]
        if event.do == "alive":
            return self._check_in(button, event, now_ns)
        del self._by_token[event.token]
        what = f"the button {button.name} has left on purpose"
        return [*self._changed(Kind.BUTTON_LEFT, what, button, now_ns), RequestAnswer()]

    def _register(self, request: ButtonRequest, now_ns: int) -> list[Effect]:
        name = request.source or ""
        mine = {token: button for token, button in self._by_token.items() if button.holder == request.holder}
        same = next((token for token, button in mine.items() if button.name == name), None)
        gives_way = same
        if same is None and len(mine) == (MOST_UNPROVED if request.holder is None else MOST_OF_ONE):
            gives_way = next((token for token, button in mine.items() if button.until_ns is None), None)
            if gives_way is None:
                whose = "" if request.holder is None else " of this certificate"
                detail = f"{len(mine)} buttons{whose} are alive, and no more can register"
                return [RequestAnswer(Reason.BUTTON_DENIED, detail)]
        until_ns = None if same is None else mine[same].until_ns
        if gives_way is not None:
            del self._by_token[gives_way]
        button = Registration(name, request.holder, request.counts, until_ns, source_id=request.source_id)
        self._by_token[request.fresh_token] = button
        button.sent_ns(request, self._rules)
        replaces = "" if same is None else ", and replaces the earlier one of this name"
        what = f"{name} is registered as a button{replaces}"
        answer = RequestAnswer(token=request.fresh_token, detail="" if request.counts else _UNCOUNTED)
        return [*self._changed(Kind.BUTTON_REGISTERED, what, button, now_ns), answer]

    def _check_in(self, button: Registration, request: ButtonRequest, now_ns: int) -> list[Effect]:
        if request.count <= button.count:
            detail = f"count is {request.count}, and {button.count} was already received: a check-in counts once"
            return [RequestAnswer(Reason.STALE, detail)]
        button.count = request.count
        sent_ns, timeout_ns = button.sent_ns(request, self._rules), self._rules.buttons_timeout_ns
        until_ns = sent_ns + timeout_ns
        if now_ns >= until_ns:
            age_ms = (now_ns - sent_ns) / NS_PER_MS
            detail = f"the check-in is {age_ms:.0f} ms old; it counts for {timeout_ns / NS_PER_MS:g} ms"
            return [RequestAnswer(Reason.STALE, detail)]
        answer = RequestAnswer(detail="" if button.counts else _UNCOUNTED)
        silent, button.silent = button.silent, False
        button.until_ns = until_ns if button.until_ns is None else max(until_ns, button.until_ns)
        if not silent:
            self._count_alive(now_ns)
            return [answer]
        what = f"the button {button.name} is back"
        return [*self._changed(Kind.BUTTON_RETURNED, what, button, now_ns), answer]

    # ----

    def _changed(
        self, kind: Kind, what: str, button: Registration, at_ns: int, key: str | None = keys.BUTTON
    ) -> list[Effect]:
        """Return the event of a change to one button; it names the legs that stop because of the change."""
        then = self._how_it_comes_down() if self._count_alive(at_ns) else ""
        detail, legs = f"{what}; {self._count()}", ALL_LEGS if then else ()
        return [Announce(kind, detail, button.name, key, legs, done=then, source_id=button.source_id)]

    def _count_alive(self, at_ns: int | None) -> bool:
        """Count the buttons that are alive. Return whether they have just become too few. None: at the beginning."""
        alive = [button for button in self._by_token.values() if button.until_ns is not None]
        self.due_ns = min((button.until_ns for button in alive if button.until_ns is not None), default=None)
        """When the next button falls silent (ns); None if none is alive."""
        self.alive = len({(each.holder, each.name if each.holder is None else "") for each in alive if each.counts})
        """How many certificates (without proofs: names) with an alive button that counts."""
        self.objection = Reason.NO_BUTTON, f"{self._count()}; nothing moves until enough check in (a page's /button)"
        before, self.closed = self.down, self.alive < self._rules.buttons_required
        self.down = (before or Down("too few buttons are alive", at_ns)) if self.closed else None
        return self.closed and before is None

    def _count(self) -> str:
        are = "is" if self.alive == 1 else "are"
        if not self._rules.buttons_required:
            return f"{self.alive} {are} alive, and none is required"
        return f"{self.alive} of the {self._rules.buttons_required} buttons that are required {are} alive"


_UNKNOWN: Final = (
    "this button is not registered: it has left, another has registered its name, or the gateway has restarted; "
    "register again"
)
_UNCOUNTED: Final = "this button stops the robot, but does not count towards those required (buttons.names)"
