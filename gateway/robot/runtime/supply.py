"""Decides which servos the power board powers, and what the board's reports mean for the robot.

With either wire, a servo is powered only while it runs or waits to be started. A Stop therefore cuts its power, and the
end of an emergency stop or of a bus fault powers no servo.

For the owner of the state; nothing here waits, since threads of the board's line send the frames. A step's cuts are
requested before its SPI frames, its powering after them. So no cut waits for SPI, and no servo is powered before its
Stop or its angle is written.

A deaf controller may still drive servos. After a fault, one servo is powered alone; the others follow once its current
shows that it rests.
"""

import asyncio
import json
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model.frames import legs_of
from gateway.robot.core.events import Announce, PowerSeen
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.ownership import Ownership
from gateway.robot.power.board import News, PowerBoard
from gateway.robot.power.currents import IDLE_MA, CurrentRules
from gateway.robot.power.line import PowerLine
from gateway.robot.power.offs import Confirmed
from gateway.robot.protocol import Wire
from gateway.robot.settings import Settings
from gateway.robot.spi.cyclic import CyclicBus
from schemas.keys import ESTOP
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Kind, Mode, PowerReport

STUCK_BEATS: Final = 30
"""Beats without progress, 3 s; a line polls a hundred times a second."""
_WHY: Final = {
    Mode.ESTOPPED: "for the emergency stop",
    Mode.BUS_FAULT: "since the controller cannot be commanded to stop",
    Mode.STOPPING: "since the gateway ends",
}
_DREW: Final = "it drew current after its Stop; a reset feeds it again"
_DEAF: Final = "servo {} drew current before it was started: the controller does not obey; a reset lets it try again"
_TAKEN: Final = "another program has switched it off; a reset feeds it again"
_ALL: Final = frozenset(SERVO_IDS)
_NONE: Final = frozenset[int]()


# ---- answers that wait until the board confirms that servos are off

MOST_ASKERS: Final = 64
"""One for each session (`limits.MAX_SESSIONS`); together they keep 4 MiB at most."""
MOST_QUESTIONS: Final = 32
"""Open at a time: 25 for each leg, each servo and the whole robot, and some for servos powered and stopped again."""

Then = Callable[[bool, float | None], None]
"""Called once: whether the board has confirmed it, and how many ms after the Stop was received (None: it has not)."""


@dataclass(slots=True)
class _Question:
    """A question whether these servos are off; for each asker, when its Stop was received (ns), and its callback."""

    servos: frozenset[int]
    asked_ns: int
    askers: list[tuple[int, Then]] = field(default_factory=list)
    takes_more: bool = True


class Confirmations:
    """The open questions to a power board. For the owner of the state.

    An open question serves everyone who asks about the same servos. A waiting answer keeps a Zenoh query and up to
    64 KiB of its receive buffer. With a silent board, a flood of acknowledged emergency stops would fill the memory.
    Therefore at most MOST_ASKERS wait for a question; further ones are answered at once that nothing is confirmed.
    """

    def __init__(self, ask: Callable[[frozenset[int], int, int], None]) -> None:
        """`ask(servos, since_ns, token)` asks the board; its answer carries the token."""
        self._ask = ask
        self._token = 0
        self._open: dict[int, _Question] = {}

    def wait(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed that these servos are off, or the time for that is over.

        `asked_ns` is when the Stop was received. With too many questions or askers, `then` is called at once.
        """
        wanted = frozenset(servos)
        question = next((each for each in self._open.values() if each.takes_more and each.servos == wanted), None)
        full = len(self._open) >= MOST_QUESTIONS if question is None else len(question.askers) >= MOST_ASKERS
        if full:
            then(False, None)
            return
        if question is None:
            self._token += 1
            question = self._open[self._token] = _Question(wanted, asked_ns)
            self._ask(wanted, asked_ns, self._token)
        question.askers.append((asked_ns, then))

    def feeds(self, servos: frozenset[int]) -> None:
        """Record that these servos are powered again. A later Stop of them needs a new question."""
        for each in self._open.values():
            if not servos.isdisjoint(each.servos):
                each.takes_more = False

    def answered(self, answer: Confirmed) -> None:
        """Take the board's answer, or the end of the time for one."""
        question = self._open.pop(answer.token, None)
        if question is None:
            return
        for asked_ns, then in question.askers:
            ms = None if answer.ms is None else answer.ms - (asked_ns - question.asked_ns) / NS_PER_MS
            if ms is not None and ms < 0:  # the board's answer is older than this asker's Stop
                self.wait(question.servos, asked_ns, then)
            else:
                then(answer.confirmed, ms)

    def close(self) -> None:
        """Call all callbacks: nothing is confirmed."""
        for token in tuple(self._open):
            self.answered(Confirmed(token, confirmed=False, ms=None))


# ---- the supply


class RobotSupply:
    # mutants accepted (FalseWithTrue, Step): the board's next news sets it; any numbers
    def __init__(
        self, line: PowerLine, interface: str, ready: Callable[[Mapping[int, int | None]], frozenset[int]] | None
    ) -> None:
        """`ready` returns those of the given servos whose angle is on the wire, if supply starts servos; else None."""
        self.line = line
        """For any thread: `status`, and `cut`, which waits neither for SPI nor for the state. Only `close` waits."""
        self.on_news: Callable[[], None] = lambda: None
        """Called, with the state owned, when the board reports something."""
        self._interface = interface
        self._ready = ready
        self._asked = self._runs = _NONE
        self._changes = 0
        """How often `_asked` has changed. A confirmation of an earlier value does not count for the present one."""
        self._mode = Mode.STARTING
        self._cut = False
        self._trusted = ready is not None
        """Whether a powered servo was seen at rest since the last fault."""
        self._withheld: dict[int, str] = {}
        """Servos not powered before a reset, and why: the board blocked them, or they drew current after a Stop."""
        self._refused: Mapping[int, str] = {}
        self._alive = False
        self._currents = CurrentRules()
        self._found: list[News] = []
        self._changed = False
        """Whether a reset or a servo's current has changed something; the board reports neither."""
        self._polled_ns = self._stuck_beats = 0
        self.confirmations = Confirmations(line.when_off)

    # ---- what a step decides

    def before_step(self, supervisor: Supervisor) -> list[Announce]:
        """Request the step's cuts, before its frames. Return the events to publish after them."""
        servos = supervisor.legs.servos
        self._runs = frozenset([each for each, servo in servos.items() if servo.angle_cdeg is not None])
        if supervisor.outside.closed:
            self._withheld |= dict.fromkeys(self._asked, _TAKEN)  # `stop-servos` cuts power even if nothing shows it
        before, self._mode = self._mode, supervisor.mode
        cuts = self._mode in _WHY and self._mode is not before and bool(self._asked)
        if self._mode in _WHY or supervisor.outside.closed:
            self._trusted = self._ready is not None
        self._ask(self._asked & supervisor.legs.to_feed().keys())
        self._cut = self._cut or cuts
        why = f"the servos' supply is taken, {_WHY[self._mode]}" if cuts else ""
        return [Announce(Kind.POWER_CUT, why, legs=tuple(LEGS))] if cuts else []

    def after_step(self, supervisor: Supervisor) -> None:
        """Request the step's powering, after its frames."""
        to_feed = supervisor.legs.to_feed()
        wanted = frozenset(to_feed) if self._ready is None else self._ready(to_feed)
        wanted = wanted.difference(self._withheld, self.line.status.refused)
        if not self._trusted and wanted:
            wanted = wanted & self._asked or frozenset([min(wanted)])
        self._ask(wanted)

    def _ask(self, servos: frozenset[int]) -> None:
        self._changes += servos != self._asked
        self._asked = servos
        self.line.want(servos, self._changes)
        self.confirmations.feeds(servos)

    def reset(self) -> None:
        """Allow blocked and cut servos to be powered again, after an accepted reset."""
        self._withheld.clear()
        self._currents = CurrentRules()
        self._changed = True
        self.line.clear_errors()

    # ---- news of the board

    def makes_progress(self) -> bool:
        """Return whether the line has polled within the last STUCK_BEATS beats. Call it once a beat."""
        polled_ns = self.line.polled_ns
        self._stuck_beats = self._stuck_beats + 1 if polled_ns == self._polled_ns else 0
        self._polled_ns = polled_ns
        return self._stuck_beats < STUCK_BEATS

    @property
    def _fed(self) -> frozenset[int]:
        """The servos that the board has confirmed to power since the latest request."""
        status = self.line.status
        return status.fed & self._asked if status.changes == self._changes else _NONE

    def judge_currents(self, now_ns: int) -> bool:
        """Compare the servos' currents with their state. Return whether there is news. Call it a few times a second."""
        status = self.line.status
        if status.alive:
            runs = self._runs if self._ready is None else self._runs | self._asked  # supply starts a servo
            unfed = runs - status.supplied  # their power is on its way: they may draw current or not
            drawn = {each: ma for each, ma in status.currents_ma.items() if each not in unfed}
            self._found += self._currents.measured(drawn, runs, now_ns)
            if not self._trusted and any(drawn.get(each, IDLE_MA + 1) <= IDLE_MA for each in self._fed - self._runs):
                self._trusted = self._changed = True
        return self._changed or bool(self._found)

    def take_news(self) -> tuple[PowerSeen, list[Announce]]:
        """Take the board's news. Return the event for the supervisor, and the events to publish."""
        announcements, doubt = list[Announce](), ""
        found, self._found, self._changed = self._found, [], False
        for each in (*self.line.news(), *found):
            if isinstance(each, Confirmed):
                self.confirmations.answered(each)
                continue
            announcements.append(Announce(each.kind, each.detail, legs=legs_of(each.servos)))
            if each.kind is Kind.SERVO_DRAWS:
                doubt = doubt or self._drew(each)
            elif each.kind is Kind.POWER_UNCONFIRMED and self.line.status.alive:
                doubt = each.detail
        status = self.line.status
        if self._cut and status.supplied & self._asked:
            self._cut = False
            announcements.append(Announce(Kind.POWER_RESTORED, "the power board feeds servos again"))
        # A silent board loses no servo: a landing robot may still have its power.
        lost = status.lost if status.alive else _NONE
        self._trusted = self._trusted and (status.alive or self._ready is not None)
        if self._alive and status.alive:  # another program took it, such as `stop-servos`
            self._withheld |= dict.fromkeys(lost - status.refused.keys(), _TAKEN)
        newly = status.refused.keys() - self._refused.keys()
        # A servo that the board, or a person at the board, has unblocked is not powered before a reset.
        self._withheld |= {servo_id: f"{status.refused[servo_id]}; a reset feeds it again" for servo_id in newly}
        self._alive, self._refused = status.alive, status.refused
        refused = {**self._withheld, **status.refused}
        fed = self._fed if self._trusted else _NONE
        return PowerSeen(status.alive, tuple(sorted(refused.items())), fed, lost, doubt), announcements

    def _drew(self, news: News) -> str:
        """Handle a servo at rest that draws current: cut its power. Return why all must stop, or "" if not."""
        if not self._trusted and news.servos & self._asked:
            deaf = _DEAF.format(min(news.servos))
            self._withheld |= dict.fromkeys(_ALL, deaf)
            return deaf
        self._withheld |= dict.fromkeys(news.servos, _DREW)
        return "" if news.servos & self._asked else news.detail

    def confirm(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed these servos off, or the time for that is over.

        If one of them was started again meanwhile, `then` is called at once. `asked_ns` is when the Stop was received.
        """
        if not self._asked.isdisjoint(servos):
            then(False, None)
            return
        self.confirmations.wait(servos, asked_ns, then)

    def report(self, now_ns: int) -> PowerReport:  # mutants accepted (Step): a nanosecond
        status = self.line.status
        return PowerReport(
            interface=self._interface,
            alive=status.alive,
            supplied=tuple(sorted(status.supplied)),
            confirmed=status.confirmed,
            age_ms=None if status.answered_ns is None else max(0, now_ns - status.answered_ns) / 1e6,
        )


def off_button(now_ns: int) -> Received:
    """Return the board's off button as a message: an emergency stop received at `now_ns`."""
    payload = json.dumps({"source": "the power board's off button"}).encode()
    return Received(
        key=ESTOP, expression=ESTOP, target=None, verb=Verb.PUT, payload=payload, size=len(payload),
        encoding="application/json", source=None, received_ns=now_ns,
    )  # fmt: skip


def supply_of(
    settings: Settings,
    wire: Wire,
    channel: str | None,
    loop: asyncio.AbstractEventLoop,
    owner: Ownership,
    failed: Callable[[Exception], None],
) -> RobotSupply | None:
    """Return the robot's supply with its line started, or None if there is no board.

    All power is cut at once, until the first Stops are written. `channel` is the terminal of a simulated board.
    `failed` is called with an unexpected exception of the line's threads. Raises ConfigError for a wrong interface.
    """
    power = settings.power
    if not power.interface:
        return None
    if channel is not None:
        power = replace(power, interface="slcan", channel=channel)
    board = PowerBoard(power.outputs, confirm_ns=round(power.confirm_ms * NS_PER_MS))

    def changed() -> None:
        with owner:
            supply.on_news()

    def on_news() -> None:
        """Let the loop wait for the state, since the board's receiving thread must not."""
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            loop.call_soon_threadsafe(changed)

    line = PowerLine(power, board, on_news, failed)
    supply = RobotSupply(line, settings.power.interface, wire.ready_servos if isinstance(wire, CyclicBus) else None)
    line.want(_NONE, 0)
    line.start()
    return supply
