"""A supervisor to talk to in short words, with milliseconds for time; every step is also judged by the oracle."""

from collections.abc import Collection
from typing import TypeVar, cast

from gateway.allowance import NS_PER_MS
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import STOP, OneServo, Op, ServoOp, servo_ids_of
from gateway.robot.core import events
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.calibration import CalibrationCommand
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind, Reason
from tests.support.history import is_coalesced, spelled_out
from tests.support.oracle import Oracle

Targets = tuple[tuple[int, ServoOp], ...]
T = TypeVar("T", bound=events.Effect)


def op(word: str) -> ServoOp:
    """`start 90`, `set 45.5` or `stop`."""
    name, _, angle = word.partition(" ")
    return STOP if name == "stop" else ServoOp(Op[name.upper()], round(float(angle) * 100))


def servo_to(servo_id: int, word: str) -> Targets:
    """One servo's target."""
    return ((servo_id, op(word)),)


def leg_to(number: int, *words: str) -> Targets:
    """A leg's three targets; a single word is for all three."""
    return tuple(zip(servo_ids_of(number), (op(word) for word in words * (3 // len(words))), strict=True))


def legs_to(numbers: str, word: str) -> Targets:
    """The same for all servos of several legs, such as "123"."""
    return tuple(target for number in numbers for target in leg_to(int(number), word))


def said(effect: events.Effect) -> str:
    """An effect in words: `command 11 start 90`, `watchdog 1 stop`, `completed 3 coalesced`, `rejected 4 stale`."""
    match effect:
        case events.Transmit(frame=frame):
            words = [_word(command) for _, command in frame.servos]
            number = frame.servo_id if isinstance(frame, OneServo) else frame.leg
            return f"{effect.cause} {number} {words[0] if len(set(words)) == 1 else ' | '.join(words)}"
        case events.Completed():
            return f"completed {effect.request.number}{' coalesced' if is_coalesced(effect.request) else ''}"
        case events.Rejected():
            return f"rejected {effect.request.number} {effect.reason}{' stopped' if effect.request.stopped else ''}"
        case events.Announce():
            return f"announce {effect.kind}"
        case events.RequestAnswer():
            return effect.reason or "granted"
        case events.SaveCalibration():
            return f"keep {effect.number}"


def _word(command: ServoOp) -> str:
    return "stop" if command.op is Op.STOP else f"{command.op.name.lower()} {command.angle_cdeg / 100:g}"


def all_stopped(cause: str) -> list[str]:
    """Stops to all six legs."""
    return [f"{cause} {number} stop" for number in range(1, 7)]


def _ns(at_ms: float) -> int:
    return round((60_000 + at_ms) * NS_PER_MS)


class Steps:
    """A supervisor whose bus was opened at 0 ms, a minute after the clock began.

    By default Stops are not repeated, and no further runs of them follow at rest.
    """

    def __init__(
        self,
        rules: Rules | None = None,
        *,
        opened: bool = True,
        calibration: RobotCalibration | None = None,
        fault: str | None = None,
    ) -> None:
        self.rules = rules or Rules(repeats=0, rest_runs=0)
        self.supervisor = Supervisor(self.rules)
        if calibration is not None or fault is not None:
            self.supervisor.calibrating.load(calibration or RobotCalibration(), fault)
        self.oracle = Oracle(self.rules, calibration=calibration, fault=fault)
        self.number = 0
        self.effects: list[events.Effect] = []
        self.instant_ms: float | None = None
        if opened:
            self.take(0, events.BusOpened())

    def take(self, at_ms: float, event: events.Event) -> list[str]:
        """One step; in the instant that began at `instant_ms`, or in one of its own.

        The words leave out the Stops that join first Stops, for legs at rest: the oracle demands each of them.
        """
        now_ns = _ns(at_ms)
        instant_ns = None if self.instant_ms is None else _ns(self.instant_ms)
        self.effects = self.supervisor.step(event, now_ns, instant_ns)
        self.oracle.judge(event, now_ns, self.effects, self.supervisor, instant_ns)
        return [said(effect) for effect in spelled_out(self.effects) if effect not in self.joining]

    @property
    def joining(self) -> list[events.Transmit]:
        """The latest step's Stops to legs at rest that leave with its first Stops."""
        return [effect for effect in self.effects if isinstance(effect, events.Transmit) and effect.joins]

    def only(self, kind: type[T]) -> T:
        """The only effect of this kind that the latest step has."""
        (found,) = [effect for effect in self.effects if isinstance(effect, kind)]
        return found

    @property
    def announced(self) -> list[events.Announce]:
        """What the latest step says to everybody."""
        return [effect for effect in self.effects if isinstance(effect, events.Announce)]

    @property
    def detail(self) -> str:
        """What the only rejection of the latest step states."""
        return self.only(events.Rejected).detail

    def command(
        self,
        at_ms: float,
        targets: Targets,
        channel: str = "leg",
        *,
        lease: str | None = None,
        source: str | None = None,
    ) -> list[str]:
        """A command with the next number."""
        self.number += 1
        return self.take(at_ms, events.Command(targets, key=channel, source=source, number=self.number, lease=lease))

    def unread(self, at_ms: float, targets: Targets, channel: str = "leg") -> list[str]:
        """A message that could not be read, and may stop these."""
        self.number += 1
        rejected = events.Rejected(events.Request(number=self.number), Reason.MALFORMED, "it is no JSON")
        return self.take(at_ms, events.Command(targets, key=channel, number=self.number, rejected=rejected))

    def lease(self, at_ms: float, words: str, token: str | None = None, *, fresh: str = "") -> list[str]:
        """A request such as `acquire anna`, `renew` or `release to bert`."""
        verb, _, name = words.partition(" ")
        to = name.removeprefix("to ") if name.startswith("to ") else None
        source = name if name and to is None else None
        return self.take(
            at_ms, events.LeaseRequest(cast(events.LeaseDo, verb), source, token=token, to=to, fresh_token=fresh)
        )

    def button(
        self,
        at_ms: float,
        verb: str,
        who: str = "",
        count: int = 0,
        *,
        sent_ms: float | None = None,
        holder: str | None = None,
        counts: bool = True,
    ) -> list[str]:
        """`register` by a name, whose token that then is as well (with a certificate, its holder's before it); `alive`
        and `leave` by that token."""
        do, token = cast(events.ButtonDo, verb), who if holder is None else f"{holder}: {who}"
        return self.take(at_ms, events.ButtonRequest(do, _ns(at_ms), who, holder, counts, token, count, sent_ms, token))

    def reset(self, at_ms: float, *, newer: int = 0, lease: str | None = None) -> list[str]:
        """A reset that names the latest emergency stop, or one that is newer (or older, if negative) by so many."""
        self.number += 1
        return self.take(
            at_ms, events.Reset(number=self.number, estop=self.supervisor.latch.number + newer, lease=lease)
        )

    def reset_without_number(self, at_ms: float) -> list[str]:
        self.number += 1
        return self.take(at_ms, events.Reset(number=self.number))

    def calibrate(
        self,
        at_ms: float,
        change: CalibrationCommand,
        *,
        revision: int | None = None,
        accept_default: bool = False,
        lease: str | None = None,
    ) -> list[str]:
        """A change with the next number."""
        self.number += 1
        event = events.Calibrate(
            number=self.number, change=change, revision=revision, accept_default=accept_default, lease=lease
        )
        event.source, event.key = "anna", "hexapod/calibration/cmd"
        return self.take(at_ms, event)

    def kept(self, at_ms: float, fault: str | None = None) -> list[str]:
        """The disk has answered for the latest change."""
        way = self.supervisor.calibrating._on_its_way
        return self.take(at_ms, events.CalibrationSaved(0 if way is None else way.event.number, fault))

    def time(self, at_ms: float) -> list[str]:
        return self.take(at_ms, events.TimePassed())

    def estop(self, at_ms: float) -> list[str]:
        return self.take(at_ms, events.EmergencyStop("somebody"))

    def outside(self, at_ms: float, *, at_work: bool) -> list[str]:
        """`stop-servos` is seen at work, or its end is."""
        return self.take(at_ms, events.StoppedOutside(at_work))

    def measure(self, at_ms: float, tilt_deg: float | None = 0, battery_v: float = 7.4) -> list[str]:
        """The robot has measured."""
        tilt_cdeg = None if tilt_deg is None else round(tilt_deg * 100)
        return self.take(at_ms, events.BodyMeasured(tilt_cdeg, round(battery_v * 1000)))

    def board(
        self,
        at_ms: float,
        *,
        alive: bool = True,
        refused: str = "",
        fed: Collection[int] = SERVO_IDS,
        lost: tuple[int, ...] = (),
        doubt: str = "",
    ) -> list[str]:
        """The power board is seen; `refused` are servo ids that it will not feed, for overcurrent."""
        why = tuple((int(servo_id), "overcurrent") for servo_id in refused.split())
        return self.take(at_ms, events.PowerSeen(alive, why, frozenset(fed), frozenset(lost), doubt))

    def fail(self, at_ms: float, kind: Kind = Kind.BUS_FAULT) -> list[str]:
        return self.take(at_ms, events.BusFailed("EIO", kind))

    def open(self, at_ms: float) -> list[str]:
        return self.take(at_ms, events.BusOpened())

    def end(self, at_ms: float) -> list[str]:
        return self.take(at_ms, events.ShutDown())

    @property
    def due_ms(self) -> float | None:
        """When it wants to be woken."""
        due_ns = self.supervisor.due_ns
        return None if due_ns is None else due_ns / NS_PER_MS - 60_000

    @property
    def running(self) -> list[int]:
        return [servo.servo_id for servo in self.supervisor.legs.servos.values() if servo.running]
