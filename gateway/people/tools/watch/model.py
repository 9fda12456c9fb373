"""The data that `watch` shows. Pure: the time is an argument.

People stand next to the robot, so three things must always be right: how old the picture is, whether the gateway is
there, and whether the emergency stop was confirmed.
"""

from collections import Counter, deque
from dataclasses import dataclass, field
from datetime import datetime
from enum import Enum, auto
from typing import Final, NamedTuple

from gateway.allowance import NS_PER_S
from gateway.people.client.dangers import tone_of
from gateway.people.client.live import Order, Starts
from gateway.people.terminal.stop_status import Remark, StopStatus, Tone
from gateway.people.walking.balance import Senses
from gateway.text import visible
from schemas.telemetry import Event, GatewayState, Kind, LegReport, Mode, Telemetry

_NS_PER_MS: Final = 1_000_000

SILENT_AFTER_NS: Final = 2_000_000_000
"""Long enough for a gateway that publishes no state, which is asked for it, and for one lost answer (live.py: 0.4 s,
0.6 s, 0.4 s). The end of its process is noticed at once, by its liveliness token."""
RATE_WINDOW_S: Final = 2.0
"""Rates are means over this time: at 10 states a second, steady to the eye and still quick to follow."""
QUESTION_NS: Final = 10 * NS_PER_S
"""An older question is withdrawn, so that a stray y answers nothing."""
SHOWN_EVENTS: Final = 200
COUNTED_SOURCES: Final = 64
"""Sources counted separately, as in the gateway; all further ones share one line."""
OTHERS: Final = "all others"
NAMELESS: Final = "no name"


class WatchedPresence(Enum):
    """Whether a gateway publishes, as far as this laptop receives."""

    WAITING = auto()  # nothing has been received yet
    LIVE = auto()
    SILENT = auto()  # something was received, and then no more


@dataclass(frozen=True, slots=True)
class EventLine:
    """One event, or an observation of `watch` itself, with a `kind` that no gateway publishes."""

    time: datetime
    kind: str
    text: str
    bad: bool


class Confirmation(Enum):
    """A question about the key that was pressed, one at a time; y is yes, any other key no."""

    RESET = auto()
    TAKE = auto()


class Counts(NamedTuple):
    """Of commands and frames, in all or per second."""

    accepted: float
    rejected: float
    coalesced: float
    frames: float

    @classmethod
    def of(cls, state: GatewayState) -> "Counts":
        """The totals of a state."""
        commands = state.commands
        return cls(commands.accepted, commands.rejected, commands.coalesced, state.spi.frames)


@dataclass(slots=True)
class Model:
    """Everything that is shown. `received_…` methods take what arrives; the others take the time."""

    state: GatewayState | None = None
    telemetry: Telemetry | None = None
    """What the robot measured last; None: it measures nothing, as far as is known."""
    carrying: tuple[bool, ...] | None = None
    """Which of legs 1 to 6 carry, by that; None: not measured."""
    own_expiry: str | None = None
    """A sentence, where this laptop's certificate expires soon."""
    trouble: str = ""
    """Why there is no connection: a line for each host."""
    stop: StopStatus = field(default_factory=StopStatus)
    remark: Remark | None = None
    """The result of another key."""
    rejected: Counter[str] = field(default_factory=Counter)
    """Commands rejected since `watch` began, by source, including those that the events leave out."""
    reasons: dict[str, str] = field(default_factory=dict)
    """The latest reason, by source."""
    lines: deque[EventLine] = field(default_factory=lambda: deque(maxlen=SHOWN_EVENTS))
    """Newest first."""
    _state_ns: int = 0
    _telemetry_ns: int = 0
    _senses: Senses = field(default_factory=Senses)
    _received_ns: int | None = None
    _gone: bool = False
    _noted: WatchedPresence = WatchedPresence.WAITING
    _samples: deque[tuple[float, Counts]] = field(default_factory=deque)
    """With the uptime of each, in seconds."""
    _starts: Starts = field(default_factory=Starts)
    _warned: set[str] = field(default_factory=set)
    drives: bool = False
    """Whether `watch` holds the lease."""
    _question: Confirmation | None = None
    _asked_ns: int = 0

    # ---- received

    def received_state(self, state: GatewayState, now_ns: int, wall: datetime) -> None:
        """A state came, published or as an answer."""
        self._receive(now_ns, wall)
        match self._starts.look(state.time, state.uptime_s, now_ns):
            case Order.RESTARTED:
                self._note(wall, "restarted", "the gateway was started again", bad=True)
                self._samples.clear()
                self.telemetry = None
            case Order.OVERTAKEN:
                return
            case Order.NEXT:
                pass
        self.state, self._state_ns = state, now_ns
        self.stop.power.received_state(state, now_ns)
        estopped = state.mode is Mode.ESTOPPED
        self.stop.receive_state(state.estop, estopped=estopped)
        if estopped:
            self.stop.state_shows_estop(now_ns)
        self._samples.append((state.uptime_s, Counts.of(state)))
        # Keep one sample that is at least a window old, so that states that come slowly also give rates.
        while len(self._samples) > 2 and state.uptime_s - self._samples[1][0] >= RATE_WINDOW_S:
            self._samples.popleft()

    def received_telemetry(self, telemetry: Telemetry, now_ns: int) -> None:
        """What the robot measures."""
        seconds = max(0, now_ns - self._telemetry_ns) / NS_PER_S
        self.telemetry, self._telemetry_ns = telemetry, now_ns
        self.carrying = self._senses.take(telemetry, seconds).carrying

    def received_event(self, event: Event, now_ns: int, wall: datetime) -> None:
        """Add an event to those that are shown."""
        self._receive(now_ns, wall)
        self.stop.power.received_event(event.kind)
        source = visible(event.source or NAMELESS)
        text = visible(event.detail)
        if event.kind is Kind.COMMAND_REJECTED:
            known = source if source in self.rejected or len(self.rejected) < COUNTED_SOURCES else OTHERS
            self.rejected[known] += 1 + event.left_out
            if event.reason is not None:
                self.reasons[known] = event.reason
            text = f"{source}: {text}"
        elif event.source is not None and source not in text:
            text = f"{text} ({source})"
        self.lines.appendleft(EventLine(event.time, visible(event.kind), text, tone_of(event.kind) == "bad"))

    def received_token(self, alive: bool, now_ns: int, wall: datetime) -> None:
        """The gateway's liveliness token came or went; it goes within milliseconds when the process ends."""
        if alive:
            self._receive(now_ns, wall)
        else:
            self._gone = True
            self.look(now_ns, wall)

    def note_others(self, warning: str, wall: datetime) -> None:
        """Warn that other programs answer, too; each warning is shown once."""
        if warning not in self._warned:
            self._warned.add(warning)
            self._note(wall, "others_answer", warning, bad=True)

    def look(self, now_ns: int, wall: datetime) -> None:
        """Notice silence, and withdraw what was shown for long enough."""
        presence = self.presence(now_ns)
        if presence is WatchedPresence.SILENT and self._noted is not WatchedPresence.SILENT:
            self._noted = presence
            self._note(wall, "silent", "the gateway fell silent", bad=True)
        self._question = self.asking(now_ns)
        if self.remark is not None and self.remark.is_over(now_ns):
            self.remark = None

    def _receive(self, now_ns: int, wall: datetime) -> None:
        if self._noted is WatchedPresence.SILENT and self._received_ns is not None:
            away_s = (now_ns - self._received_ns) / NS_PER_S
            self._note(wall, "back", f"the gateway publishes again, after {away_s:.1f} s", bad=False)
        self._received_ns, self._gone, self._noted, self.trouble = now_ns, False, WatchedPresence.LIVE, ""

    def _note(self, wall: datetime, kind: str, text: str, *, bad: bool) -> None:
        self.lines.appendleft(EventLine(wall, kind, text, bad))

    # ---- derived

    def presence(self, now_ns: int) -> WatchedPresence:
        """Whether the gateway publishes, as far as is known."""
        if self._received_ns is None:
            return WatchedPresence.WAITING
        return (
            WatchedPresence.SILENT
            if self._gone or now_ns - self._received_ns > SILENT_AFTER_NS
            else WatchedPresence.LIVE
        )

    def silent_s(self, now_ns: int) -> float:
        """For how long nothing has been received."""
        return 0.0 if self._received_ns is None else (now_ns - self._received_ns) / NS_PER_S

    def state_age_ms(self, now_ns: int) -> float:
        """How long ago the state came; infinite before the first."""
        return float("inf") if self.state is None else (now_ns - self._state_ns) / _NS_PER_MS

    def measured_age_ms(self, now_ns: int) -> float:
        """How old the oldest of the robot's measurements is; 0 without any."""
        return 0.0 if self.telemetry is None else self.telemetry.age_ms + (now_ns - self._telemetry_ns) / _NS_PER_MS

    def command_age_ms(self, leg: LegReport, now_ns: int) -> float | None:
        """The age of the leg's last accepted command: as in the state, plus the time since the state came."""
        return None if leg.age_ms is None else leg.age_ms + self.state_age_ms(now_ns)

    def running_legs(self) -> int:
        """Legs with a running servo, in the last state."""
        legs = () if self.state is None else self.state.legs
        return sum(any(servo.running for servo in leg.servos) for leg in legs)

    def rates(self) -> Counts | None:
        """Per second by the gateway's own clock, means over the window; None until two states have been received."""
        if len(self._samples) < 2:
            return None
        (first_s, first), (last_s, last) = self._samples[0], self._samples[-1]
        span_s = last_s - first_s
        return Counts(*((now - then) / span_s for then, now in zip(first, last, strict=True))) if span_s > 0 else None

    # ---- questions

    def ask(self, question: Confirmation, now_ns: int) -> None:
        """Ask whether the key is meant; the reset only while an emergency stop is engaged."""
        estopped = self.state is not None and self.state.mode is Mode.ESTOPPED
        nothing = self.presence(now_ns) is WatchedPresence.LIVE and not estopped and self.stop.wanted_ns is None
        if question is Confirmation.RESET and nothing:
            self.answered(Tone.NOTE, "no emergency stop is engaged, so there is nothing to reset", now_ns)
            return
        self._question, self._asked_ns = question, now_ns

    def asking(self, now_ns: int) -> Confirmation | None:
        """The question that is on the screen."""
        return self._question if now_ns - self._asked_ns < QUESTION_NS else None

    def question(self, now_ns: int) -> str | None:
        """The question that waits for the person's answer, in words."""
        match self.asking(now_ns), self.holder:
            case None, _:
                return None
            case Confirmation.RESET, _:
                asked = "Leave the emergency stop? Nothing moves until it is started again."
            case Confirmation.TAKE, None:
                asked = "Drive? Nobody else's starts, sets and resets count then, until t is pressed again."
            case Confirmation.TAKE, str(holder):
                asked = f"Take it from {visible(holder)}? All six legs stop first."
        return f"{asked}  y: yes  n: no"

    def declined(self, now_ns: int) -> None:
        """The answer was no."""
        taken = self._question is Confirmation.TAKE
        self._question = None
        text = "not taken" if taken else "no reset: the emergency stop stays engaged"
        self.answered(Tone.NOTE, text, now_ns)

    # ---- emergency stop and reset

    def stop_pressed(self) -> None:
        """A Stop key withdraws the question, and the result of earlier keys."""
        self._question = self.remark = None

    def reset_confirmed(self, now_ns: int) -> None:
        """The answer was yes."""
        self._question = None
        self.answered(Tone.NOTE, "reset: sent, waiting for the answer", now_ns)

    # ---- who is driving

    @property
    def holder(self) -> str | None:
        """Who drives, in the last state."""
        return None if self.state is None else self.state.lease.holder

    def take_confirmed(self, now_ns: int) -> None:
        """The answer was yes."""
        self._question = None
        self.answered(Tone.NOTE, "lease: sent, waiting for the answer", now_ns)

    def answered(self, tone: Tone, text: str, now_ns: int) -> None:
        """The result of a reset, or of a key about the lease."""
        self.stop.outcome = None
        self.remark = Remark(tone, visible(text), now_ns)
