"""Carries out what the core decides about the servos' supply, and turns the power board's reports into events.

For the owner of the state; nothing here waits, since threads of the board's line send the frames. A step's cuts are
requested before its SPI frames, its feeds after them. So no cut waits for SPI, and no servo is powered before its
Stop or its angle is written.
"""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from gateway.model.frames import legs_of
from gateway.model.power_board import SUPPLY_BATTERY_MV
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core.events import Announce, ClearErrors, Cut, Effect, Feed, PowerSeen
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.power.board import Confirmed, News, PowerBoard, Then
from gateway.robot.power.line import PowerLine
from gateway.robot.spi import Wire
from schemas.keys import ESTOP
from schemas.words import Kind

STUCK_BEATS: Final = 30
"""Beats without progress, 3 s; a line polls a hundred times a second."""
_NONE: Final = frozenset[int]()
MOST_WAITING: Final = 256
"""Answers that wait for the board: each keeps a Zenoh query and up to 64 KiB of its receive buffer, 16 MiB together.
With a silent board, a flood of acknowledged emergency stops would fill the memory."""


# ---- what the currents show

IDLE_MA: Final = 150
"""A powered servo at rest draws about 8 mA, one that bears its share of a standing robot about 200 mA (assumed)."""
SETTLE_NS: Final = 300 * NS_PER_MS
"""After a Stop a servo may draw current while it comes to rest. Its current is measured every 70 ms."""
NOTHING_MA: Final = 5
"""Below the 8 mA of a powered servo's electronics."""
SILENT_NS: Final = 1 * NS_PER_S
_SENTENCES: Final = {
    Kind.SERVO_SILENT: "servo {} runs and has drawn nothing for 1 s: it is unplugged, or broken",
    Kind.SERVO_DRAWS: f"servo {{}} is stopped and draws {{:.0f}} mA, more than {IDLE_MA} mA",
}
_Finding = tuple[int, Kind, str]
"""A servo, what its current shows, and that as a sentence."""


@dataclass(slots=True)
class Judged:
    runs: bool
    since_ns: int
    """When it began to run, or to be stopped."""
    wrong_ns: int | None = None
    """Since when its measurements contradict its state, or None."""
    reported: bool = False


def findings(
    judged: dict[int, Judged], currents_ma: Mapping[int, float], running: frozenset[int], now_ns: int
) -> list[_Finding]:
    """Compare new currents with the servos' state; `running` are those that run. Return what to report.

    A stopped servo that draws current has not received its Stop. A running one without current is unplugged or broken.
    `judged` keeps what is known, and is changed: each finding is reported once for each start and Stop.
    """
    found: list[_Finding] = []
    for servo_id, ma in currents_ma.items():
        runs = servo_id in running
        servo = judged.get(servo_id)
        if servo is None or servo.runs is not runs:
            servo = judged[servo_id] = Judged(runs, now_ns)
        if not (ma < NOTHING_MA if runs else ma > IDLE_MA and now_ns - servo.since_ns >= SETTLE_NS):
            servo.wrong_ns = None
        elif servo.wrong_ns is None:  # one measurement may be wrong
            servo.wrong_ns = now_ns
        elif not servo.reported and now_ns - servo.wrong_ns >= (SILENT_NS if runs else 0):
            servo.reported = True
            kind = Kind.SERVO_SILENT if runs else Kind.SERVO_DRAWS
            found.append((servo_id, kind, _SENTENCES[kind].format(servo_id, ma)))
    return found


# ---- the supply


class RobotSupply:
    """For the owner of the state. The line's first mask cuts all power."""

    # mutants accepted (FalseWithTrue, Step): the first step sets it; any numbers
    def __init__(self, line: PowerLine, supervisor: Supervisor, wire: Wire) -> None:
        self.line = line
        """For any thread: `status`, and `cut`, which waits neither for SPI nor for the state. Only `close` waits."""
        self._supervisor = supervisor
        self._ready = wire.ready_servos
        self._asked = _NONE
        self._feed: Mapping[int, int | None] = {}
        """The servos to power. Without an angle on the wire they are not powered yet."""
        self._changes = 0
        """How often `_asked` has changed. A confirmation of an earlier value does not count for the present one."""
        self._judged: dict[int, Judged] = {}
        self._found: list[_Finding] = []
        self._rests = False
        """Whether a powered servo that does not run was seen at rest."""
        self._polled_ns = self._stuck_beats = 0
        self._waiting: set[Then] = set()
        """Answers that wait for the board."""
        self._ask(_NONE)

    # ---- a step's effects

    def before_frames(self, effects: Sequence[Effect]) -> None:
        """Request a step's cut."""
        for effect in effects:
            if type(effect) is Cut:
                if effect.everything:
                    self.line.request(PowerBoard.cut)
                self._feed = {each: angle for each, angle in self._feed.items() if each in effect.keep}
                self._ask(self._asked & effect.keep)

    def after_frames(self, effects: Sequence[Effect], *, fault: bool) -> None:
        """Request what a step feeds, unless a frame has failed: the step for the fault follows, and feeds nothing."""
        for effect in effects:
            if type(effect) is ClearErrors:
                self._judged.clear()
                self.line.request(PowerBoard.clear_errors)
            elif type(effect) is Feed and not fault:
                self._feed = effect.servos
                self.feed_ready()

    def feed_ready(self) -> None:
        """Power the servos to feed. If supply starts servos, power those whose angle is on the wire."""
        ready = frozenset(self._feed) if self._ready is None else self._ready(self._feed)
        if ready != self._asked:
            self._ask(ready)

    def _ask(self, servos: frozenset[int]) -> None:
        changes = self._changes = self._changes + (servos != self._asked)
        self._asked = servos
        self.line.request(lambda board, now_ns: board.want(servos, changes, now_ns))

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
        return status.fed if status.changes == self._changes else _NONE

    @property
    def battery_mv(self) -> int | None:
        """The battery's voltage as the board measures it, or None if the board is silent or has not measured it yet."""
        status = self.line.status
        volts_mv = status.rails.get(SUPPLY_BATTERY_MV) if status.alive else None
        return None if volts_mv is None else volts_mv[1]

    def judge_currents(self, now_ns: int) -> bool:
        """Compare the servos' currents with their state. Return whether there is news. Call it a few times a second."""
        status, servos = self.line.status, self._supervisor.legs.servos
        if status.alive:
            run = frozenset([each for each, servo in servos.items() if servo.running])
            fed_run = run if self._ready is None else run | self._asked  # supply starts a servo
            unfed = fed_run - status.supplied  # their power is on its way: they may draw current or not
            drawn = {each: ma for each, ma in status.currents_ma.items() if each not in unfed}
            self._found += findings(self._judged, drawn, fed_run, now_ns)
            self._rests = any(drawn.get(each, IDLE_MA + 1) <= IDLE_MA for each in self._fed - run)
        return bool(self._found) or (self._rests and not self._supervisor.power.trusted)

    def take_news(self, news: Iterable[News | Confirmed]) -> tuple[PowerSeen, list[Announce]]:
        """Take the board's news. Return the event for the supervisor, and the events to publish."""
        announcements, doubt, status = list[Announce](), "", self.line.status
        found, self._found, rests, self._rests = self._found, [], self._rests, False
        for each in news:
            if isinstance(each, Confirmed):
                self._waiting.discard(each.then)
                each.then(each.ms)
                continue
            announcements.append(Announce(Kind(each.kind), each.detail, legs=legs_of(each.servos)))
            if each.kind == "power_unconfirmed" and status.alive:
                doubt = each.detail
        announcements += [Announce(kind, detail, legs=legs_of([servo_id])) for servo_id, kind, detail in found]
        drew = tuple((servo_id, detail) for servo_id, kind, detail in found if kind is Kind.SERVO_DRAWS)
        refused = tuple(sorted(status.refused.items()))
        taken, supplied = status.taken, status.supplied
        seen = PowerSeen(status.alive, refused, self._fed, status.lost, doubt, taken, supplied, drew, rests)
        return seen, announcements

    # ---- answers that wait until the board confirms that servos are off

    def confirm(self, servos: Collection[int], asked_ns: int, then: Then) -> None:
        """Call `then` once the board has confirmed these servos off, or the time for that is over.

        `asked_ns` is when the Stop was received. If one of the servos was started again meanwhile, or too many answers
        wait, `then` is called at once.
        """
        if not self._asked.isdisjoint(servos) or len(self._waiting) >= MOST_WAITING:
            then(None)
            return
        self._waiting.add(then)
        off = frozenset(servos)
        self.line.request(lambda board, now_ns: board.when_off(off, asked_ns, then, now_ns))

    def close(self) -> None:
        """End all waiting: nothing is confirmed."""
        while self._waiting:
            self._waiting.pop()(None)


def off_button(now_ns: int) -> Received:
    """Return the board's off button as a message: an emergency stop received at `now_ns`."""
    payload = json.dumps({"source": "the power board's off button"}).encode()
    return Received(
        key=ESTOP, expression=ESTOP, target=None, verb=Verb.PUT, payload=payload, size=len(payload),
        encoding="application/json", source=None, received_ns=now_ns,
    )  # fmt: skip
