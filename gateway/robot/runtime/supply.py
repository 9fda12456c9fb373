"""What the power board is to feed, by what the supervisor decides; and what its news mean for the robot.

A servo is fed while it runs or waits to be started, and at no other time, with either wire. So a Stop takes its supply,
and nothing that ends (an emergency stop, a fault of the bus) feeds a servo that nobody started.

Called by the owner of the state, and waits for nothing: the board's frames leave on threads of its line's own. What a
step takes off is asked for before the step's frames, and what it feeds behind them. So no cut waits for a transfer on
SPI, and no servo is fed before its Stop, or its angle, was written.

A deaf controller may still drive servos. So the first servo that is fed behind a fault is fed alone, and
the others follow once its current shows that it rests.
"""

import asyncio
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final, Protocol

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Announce, PowerSeen
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.ownership import Ownership
from gateway.robot.power.board import News, PowerBoard, Status
from gateway.robot.power.currents import IDLE_MA, CurrentRules
from gateway.robot.power.line import PowerLine
from gateway.robot.power.offs import Confirmed
from gateway.robot.protocol import Wire
from gateway.robot.runtime.answers import legs_of
from gateway.robot.runtime.confirmations import Confirmations, Then
from gateway.robot.settings import Settings
from gateway.robot.spi.cyclic import CyclicBus
from schemas.keys import ESTOP
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Kind, Mode, PowerReport

MOST_LOOKS: Final = 30
"""3 s, in which a line looks three hundred times."""
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


class BoardLine(Protocol):
    """What is asked of the line to the board (`robot.power.line`). Any thread may call `cut`; only `close` waits."""

    @property
    def status(self) -> Status: ...
    @property
    def looked_ns(self) -> int: ...
    def want(self, servos: frozenset[int], number: int) -> None: ...
    def cut(self) -> None: ...
    def when_off(self, servos: frozenset[int], asked_ns: int, token: int) -> None: ...
    def clear_errors(self) -> None: ...
    def news(self) -> Sequence[News | Confirmed]: ...
    def close(self) -> None: ...


class RobotSupply:
    """The servos' supply."""

    def __init__(
        self, line: BoardLine, interface: str, ready: Callable[[Mapping[int, int | None]], frozenset[int]] | None
    ) -> None:
        """`ready` names those of the servos to feed whose angle is on the wire, where supply is what starts a servo."""
        self._line = line
        self.cut_early = line.cut
        """From any thread, without the state, which a transfer on SPI may hold: take all supply."""
        self.end = line.close
        """Close the line; not for the owner, as it waits."""
        self.on_news: Callable[[], None] = lambda: None
        """Called, with the state owned, when the board reports something."""
        self._interface = interface
        self._ready = ready
        self._asked = self._runs = _NONE
        self._changes = 0
        """How often `_asked` has changed: what the board has confirmed before is no confirmation of it."""
        self._mode = Mode.STARTING
        self._cut = False
        self._trusted = ready is not None
        """Whether a servo was seen at rest, fed, since the last fault."""
        self._withheld: dict[int, str] = {}
        """Servos that are not fed before a reset, and why: blocked by the board, or they drew current after a Stop."""
        self._refused: Mapping[int, str] = {}
        self._alive = False
        self._currents = CurrentRules()
        self._found: list[News] = []
        """What the currents show."""
        self._changed = False
        """By a reset or a servo's current; the board reports neither as news."""
        self._looked_ns = self._looks = 0
        self.confirmations = Confirmations(line.when_off)

    # ---- what a step decides

    def before_step(self, supervisor: Supervisor) -> list[Announce]:
        """Before its frames: what is to be off. Returns what is to be published behind them."""
        servos = supervisor.legs.servos
        self._runs = frozenset([each for each, servo in servos.items() if servo.angle_cdeg is not None])
        if supervisor.stopped_outside:
            self._withheld |= dict.fromkeys(self._asked, _TAKEN)  # `stop-servos` takes it, also where nothing shows it
        before, self._mode = self._mode, supervisor.mode
        cuts = self._mode in _WHY and self._mode is not before and bool(self._asked)
        if self._mode in _WHY or supervisor.stopped_outside:
            self._trusted = self._ready is not None
        self._ask(self._asked & supervisor.to_feed().keys())
        self._cut = self._cut or cuts
        why = f"the servos' supply is taken, {_WHY[self._mode]}" if cuts else ""
        return [Announce(Kind.POWER_CUT, why, legs=tuple(LEGS))] if cuts else []

    def after_step(self, supervisor: Supervisor) -> None:
        """Behind its frames: what is to be on."""
        to_feed = supervisor.to_feed()
        wanted = frozenset(to_feed) if self._ready is None else self._ready(to_feed)
        wanted = wanted.difference(self._withheld, self._line.status.refused)
        if not self._trusted and wanted:
            wanted = wanted & self._asked or frozenset([min(wanted)])
        self._ask(wanted)

    def _ask(self, servos: frozenset[int]) -> None:
        self._changes += servos != self._asked
        self._asked = servos
        self._line.want(servos, self._changes)
        self.confirmations.feeds(servos)

    def reset(self) -> None:
        """A reset was accepted: what was blocked or taken may be fed again."""
        self._withheld.clear()
        self._currents = CurrentRules()
        self._changed = True
        self._line.clear_errors()

    # ---- news of the board

    def makes_progress(self) -> bool:
        """Whether the line still listens, and has not stood still for MOST_LOOKS beats of the loop, one of them now."""
        looked_ns = self._line.looked_ns
        self._looks = self._looks + 1 if looked_ns == self._looked_ns else 0
        self._looked_ns = looked_ns
        return self._looks < MOST_LOOKS

    @property
    def _fed(self) -> frozenset[int]:
        """The servos that the board has confirmed to feed since that was asked for."""
        status = self._line.status
        return status.fed & self._asked if status.changes == self._changes else _NONE

    def judge_currents(self, now_ns: int) -> bool:
        """Compare what servos do with what they draw: whether there is news. A few times a second."""
        status = self._line.status
        if status.alive:
            unfed = self._runs - status.supplied  # on its way: it may draw, and need not
            drawn = {each: ma for each, ma in status.currents_ma.items() if each not in unfed}
            self._found += self._currents.measured(drawn, self._runs, now_ns)
            if not self._trusted and any(drawn.get(each, IDLE_MA + 1) <= IDLE_MA for each in self._fed - self._runs):
                self._trusted = self._changed = True
        return self._changed or bool(self._found)

    def take_news(self) -> tuple[PowerSeen, list[Announce]]:
        """Take the news: what they mean to the supervisor, and what is to be published."""
        announcements, doubt = list[Announce](), ""
        found, self._found, self._changed = self._found, [], False
        for each in (*self._line.news(), *found):
            if isinstance(each, Confirmed):
                self.confirmations.answered(each)
                continue
            announcements.append(Announce(each.kind, each.detail, legs=legs_of(each.servos)))
            if each.kind is Kind.SERVO_DRAWS:
                doubt = doubt or self._drew(each)
            elif each.kind is Kind.POWER_UNCONFIRMED and self._line.status.alive:
                doubt = each.detail
        status = self._line.status
        if self._cut and status.supplied & self._asked:
            self._cut = False
            announcements.append(Announce(Kind.POWER_RESTORED, "the power board feeds servos again"))
        # Of a silent board nobody knows: what lands keeps its supply, if it has any.
        lost = status.lost if status.alive else _NONE
        self._trusted = self._trusted and (status.alive or self._ready is not None)
        if self._alive and status.alive:  # another program took it, such as `stop-servos`
            self._withheld |= dict.fromkeys(lost - status.refused.keys(), _TAKEN)
        newly = status.refused.keys() - self._refused.keys()
        # One that the board, or a person at it, has unblocked is not fed before a reset.
        self._withheld |= {servo_id: f"{status.refused[servo_id]}; a reset feeds it again" for servo_id in newly}
        self._alive, self._refused = status.alive, status.refused
        refused = {**self._withheld, **status.refused}
        fed = self._fed if self._trusted else _NONE
        return PowerSeen(status.alive, tuple(sorted(refused.items())), fed, lost, doubt), announcements

    def _drew(self, news: News) -> str:
        """A servo draws current that is to be at rest. Return why all is to be stopped; empty: its supply goes."""
        if not self._trusted and news.servos & self._asked:
            deaf = _DEAF.format(min(news.servos))
            self._withheld |= dict.fromkeys(_ALL, deaf)
            return deaf
        self._withheld |= dict.fromkeys(news.servos, _DREW)
        return "" if news.servos & self._asked else news.detail

    def confirm(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed that these are off, or it is too late for it; at once where one of
        them was started again meanwhile."""
        if not self._asked.isdisjoint(servos):
            then(False, None)
            return
        self.confirmations.wait(servos, asked_ns, then)

    def report(self, now_ns: int) -> PowerReport:
        """For the state."""
        status = self.status
        return PowerReport(
            interface=self._interface,
            alive=status.alive,
            supplied=tuple(sorted(status.supplied)),
            confirmed=status.confirmed,
            age_ms=None if status.answered_ns is None else max(0, now_ns - status.answered_ns) / 1e6,
        )

    @property
    def status(self) -> Status:
        """What is known of the board."""
        return self._line.status


def off_button(now_ns: int) -> Received:
    """Return the message of the board's off button: an emergency stop like any other."""
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
    """The supply of this robot, with its line begun; None: there is no board. Raises ConfigError.

    `channel` is the terminal of a simulated board. What is on is taken off at once, until the first Stops are written.
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
        """What receives from the board must not wait for the state: the loop does."""
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            loop.call_soon_threadsafe(changed)

    line = PowerLine(power, board, on_news, failed)
    supply = RobotSupply(line, settings.power.interface, wire.ready_servos if isinstance(wire, CyclicBus) else None)
    line.want(_NONE, 0)
    line.start()
    return supply
