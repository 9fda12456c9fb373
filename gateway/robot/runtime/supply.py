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
from dataclasses import dataclass, replace
from typing import Final

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.model.frames import legs_of
from gateway.robot.core.events import Announce, PowerSeen
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.ownership import Ownership
from gateway.robot.power.board import Confirmed
from gateway.robot.power.line import PowerLine
from gateway.robot.settings import Settings
from gateway.robot.spi import Wire
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


MOST_WAITING: Final = 256
"""Answers that wait for the board: each keeps a Zenoh query and up to 64 KiB of its receive buffer, 16 MiB together.
With a silent board, a flood of acknowledged emergency stops would fill the memory."""

Then = Callable[[float | None], None]
"""Called once: how many ms after the Stop was received the board has confirmed it; None: it has not."""


# ---- what the currents show

IDLE_MA: Final = 150
"""A powered servo at rest draws about 8 mA, one that bears its share of a standing robot about 200 mA (assumed)."""
SETTLE_NS: Final = 300 * NS_PER_MS
"""After a Stop a servo may draw current while it comes to rest. Its current is measured every 70 ms."""
NOTHING_MA: Final = 5
"""Below the 8 mA of a powered servo's electronics."""
SILENT_NS: Final = 1 * NS_PER_S
IN_A_ROW: Final = 2
"""Measurements of a stopped servo's current before its power is cut, since one may be wrong."""


_SENTENCES: Final = {
    Kind.SERVO_SILENT: "servo {} runs and has drawn nothing for 1 s: it is unplugged, or broken",
    Kind.SERVO_DRAWS: f"servo {{}} is stopped and draws {{:.0f}} mA, more than {IDLE_MA} mA",
}
_Finding = tuple[int, Kind, str]
"""A servo, what its current shows, and that as a sentence."""


@dataclass(slots=True)
class _Judged:
    runs: bool
    since_ns: int
    """When it began to run, or to be stopped. If it runs: since when it draws nothing."""
    wrong: int = 0
    """How many of the latest measurements contradict its state."""
    reported: bool = False


class CurrentRules:
    """Compares the servos' currents with their state. Each finding is reported once for each start and Stop.

    A stopped servo that draws current has not received its Stop. A running one without current is unplugged or broken.
    """

    def __init__(self) -> None:
        self._servos: dict[int, _Judged] = {}

    def measured(self, currents_ma: Mapping[int, float], running: frozenset[int], now_ns: int) -> list[_Finding]:
        """Take new currents in mA. `running` are the servos that run. Return what to report."""
        found: list[_Finding] = []
        for servo_id, ma in currents_ma.items():
            runs = servo_id in running
            servo = self._servos.get(servo_id)
            if servo is None or servo.runs is not runs:
                servo = self._servos[servo_id] = _Judged(runs, now_ns)
            wrong = ma < NOTHING_MA if runs else ma > IDLE_MA and now_ns - servo.since_ns >= SETTLE_NS
            servo.wrong = servo.wrong + 1 if wrong else 0
            if runs and servo.wrong < IN_A_ROW:
                servo.since_ns = now_ns
            if servo.reported or servo.wrong < IN_A_ROW or (runs and now_ns - servo.since_ns < SILENT_NS):
                continue
            servo.reported = True
            kind = Kind.SERVO_SILENT if runs else Kind.SERVO_DRAWS
            found.append((servo_id, kind, _SENTENCES[kind].format(servo_id, ma)))
        return found


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
        """Servos not powered before a reset, and why. The board blocks others (`Status.refused`)."""
        self._alive = False
        self._currents = CurrentRules()
        self._found: list[_Finding] = []
        self._changed = False
        """Whether a reset or a servo's current has changed something; the board reports neither."""
        self._polled_ns = self._stuck_beats = 0
        self._token = 0
        self._waiting: dict[int, Then] = {}
        """Answers that wait for the board, by token."""

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
        for each in self.line.news():
            if isinstance(each, Confirmed):
                self._answer(each.token, each.ms)
                continue
            announcements.append(Announce(Kind(each.kind), each.detail, legs=legs_of(each.servos)))
            if each.kind == "power_unconfirmed" and self.line.status.alive:
                doubt = each.detail
        for servo_id, kind, detail in found:
            announcements.append(Announce(kind, detail, legs=legs_of([servo_id])))
            if kind is Kind.SERVO_DRAWS:
                why = self._drew(servo_id, detail)  # of each: none may start before a reset
                doubt = doubt or why
        status = self.line.status
        if self._cut and status.supplied & self._asked:
            self._cut = False
            announcements.append(Announce(Kind.POWER_RESTORED, "the power board feeds servos again"))
        # A silent board loses no servo: a landing robot may still have its power.
        lost = status.lost if status.alive else _NONE
        self._trusted = self._trusted and (status.alive or self._ready is not None)
        if self._alive and status.alive:  # another program took it, such as `stop-servos`
            self._withheld |= dict.fromkeys(lost - status.refused.keys(), _TAKEN)
        self._alive = status.alive
        refused = self._withheld | {servo: f"{why}; a reset feeds it again" for servo, why in status.refused.items()}
        fed = self._fed if self._trusted else _NONE
        return PowerSeen(status.alive, tuple(sorted(refused.items())), fed, lost, doubt), announcements

    def _drew(self, servo_id: int, detail: str) -> str:
        """Handle a servo at rest that draws current: cut its power. Return why all must stop, or "" if not."""
        if not self._trusted and servo_id in self._asked:
            deaf = _DEAF.format(servo_id)
            self._withheld |= dict.fromkeys(_ALL, deaf)
            return deaf
        self._withheld[servo_id] = _DREW
        return "" if servo_id in self._asked else detail

    # ---- answers that wait until the board confirms that servos are off

    def confirm(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed these servos off, or the time for that is over.

        `asked_ns` is when the Stop was received. If one of the servos was started again meanwhile, or too many answers
        wait, `then` is called at once.
        """
        if not self._asked.isdisjoint(servos) or len(self._waiting) >= MOST_WAITING:
            then(None)
            return
        self._token += 1
        self._waiting[self._token] = then
        self.line.when_off(frozenset(servos), asked_ns, self._token)

    def _answer(self, token: int, ms: float | None) -> None:
        then = self._waiting.pop(token, None)
        if then is not None:
            then(ms)

    def close(self) -> None:
        """End all waiting: nothing is confirmed."""
        for token in tuple(self._waiting):
            self._answer(token, None)

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

    def changed() -> None:
        with owner:
            supply.on_news()

    def on_news() -> None:
        """Let the loop wait for the state, since the board's receiving thread must not."""
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            loop.call_soon_threadsafe(changed)

    line = PowerLine(power, on_news, failed)
    supply = RobotSupply(line, settings.power.interface, wire.ready_servos if isinstance(wire, CyclicBus) else None)
    line.want(_NONE, 0)
    line.start()
    return supply
