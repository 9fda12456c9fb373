"""Scenes: events for a supervisor in short words, at times in milliseconds. The oracle judges each step, too.

A scene is text: a line is an instant, what comes then, and what the step says.

    100 leg 1 start 90 → command 1 start 90; completed 1
    120 servo 12 set 45 (lease anna) → nothing
    due 350
    350 time → …; announce watchdog_expired  # why it is so

`…` stands for anything, `estop 1-6 stop` for a Stop to each leg. A line without an instant is a fact (FACTS). A long
line continues in the next one, from its arrow on. A first line `rules repeats=2, start_pause_ms=50` states the rules
(otherwise those of Scenes), and `unopened` that the bus is not open yet.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, TypeVar, cast

import pytest

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OneServo, Op
from gateway.rate_limit import NS_PER_MS
from gateway.robot.core import events
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.calibration import CalibrationCommand, ServoChange
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Kind
from tests.support.history import announced, frames_of, is_coalesced, spelled_out, supply_of
from tests.support.model_check import pending
from tests.support.oracle import Oracle
from tests.support.small_robots import settings_of, targets_of

T = TypeVar("T", bound=events.Effect)
Options = dict[str, str]


def said(effect: events.Effect) -> str:  # noqa: PLR0911
    """Return `command 11 start 90`, `watchdog 1 stop`, `completed 3 coalesced`, `rejected 4 stale`, and so on."""
    match effect:
        case events.Transmit(frame=frame):
            ops = (op for _, op in frame.servos)
            words = ["stop" if op.op is Op.STOP else f"{op.op.name.lower()} {op.angle_cdeg / 100:g}" for op in ops]
            number = frame.servos[0][0] if isinstance(frame, OneServo) else frame.leg
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
        case events.Cut():
            return "cut" if effect.everything else f"cut but {_named(effect.keep)}"
        case events.Feed():
            return f"feed {_named(effect.servos)}"
        case events.ClearErrors():
            return "clear errors"


def _named(servo_ids: Iterable[int]) -> str:
    return " ".join(map(str, sorted(servo_ids))) or "none"


def all_stopped(cause: str) -> list[str]:
    """Return the words of Stops to all six legs."""
    return [f"{cause} {number} stop" for number in LEGS]


def _ns(at_ms: float) -> int:
    return round((60_000 + at_ms) * NS_PER_MS)


class Scenes:
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
        rules = rules or Rules(repeats=0, rest_runs=0)
        self.supervisor = Supervisor(rules)
        if calibration is not None or fault is not None:
            self.supervisor.calibrating.load(calibration or RobotCalibration(), fault)
        self.oracle = Oracle(rules, calibration=calibration, fault=fault)
        self.effects: list[events.Effect] = []
        self.halted: list[events.Announce] = []
        self.supply: list[str] = []
        """What was cut, and what is fed, by the latest step that changed either. The oracle demands it."""
        self.instant_ms: float | None = None
        self._number = 0
        if opened:
            self.take(0, events.BusOpened())

    def take(self, at_ms: float, event: events.Event) -> list[str]:
        """Take one step, in the instant that began at `instant_ms` or in one of its own. Return its effects in words.

        Words and `effects` leave out `legs_stopped` and the supply, and words the Stops that join first Stops, for
        legs at rest: the oracle demands each of them.
        """
        now_ns = _ns(at_ms)
        instant_ns = None if self.instant_ms is None else _ns(self.instant_ms)
        found = self.supervisor.step(event, now_ns, instant_ns)
        self.effects = [_written(each) if isinstance(each, events.Announce) else each for each in found]
        self.oracle.judge(event, now_ns, self.effects, self.supervisor, instant_ns)
        self.halted = announced(self.effects, {Kind.LEGS_STOPPED})
        self.effects = [each for each in self.effects if each not in self.halted]
        supply = supply_of(self.effects)
        self.supply = [*map(said, supply)] or self.supply
        self.effects = [each for each in self.effects if each not in supply]
        return [said(each) for each in spelled_out(self.effects) if each not in self.joining]

    def do(self, at_ms: float, words: str) -> list[str]:
        """Take one step in words. Options stand in parentheses: `(lease anna, key legs)`. `lost leg 2 stop`: messages
        were lost, perhaps this one. `timed leg 2 start 90`: it has its time, on a key of its own."""
        words, _, rest = words.partition(" (")
        options = dict(option.strip().split(" ", 1) for option in rest.rstrip(") ").split(",") if option)
        what, _, more = words.strip().partition(" ")
        if what == "pass":
            return self._pass(at_ms)
        if what in ("leg", "legs", "servo"):
            key, lease, source = options.get("key", "leg"), options.get("lease"), options.get("source")
            number, targets = self.next_number(), targets_of(words)
            return self.take(
                at_ms,
                events.Command(targets, frames=frames_of(targets), key=key, source=source, number=number, lease=lease),
            )
        if what in ("lost", "timed"):
            lost, sent_ms = what == "lost", None if what == "lost" else 1
            command = events.Command(targets_of(more), key=what, number=99, lost=lost, sent_ms=sent_ms)
            return self.take(at_ms, command)
        if what == "button":
            verb, who, *count = more.split()
            sent = float(options["sent"]) if "sent" in options else None
            return self.button(at_ms, verb, who, *map(int, count), sent_ms=sent, holder=options.get("holder"))
        return self.take(at_ms, STEPS[what](self, more, options))

    def play(self, scene: str) -> "Scenes":
        """Take each line of a scene."""
        for line in lines_of(scene):
            done, arrow, expected = line.partition("  #")[0].partition("→")
            at, _, words = done.strip().partition(" ")
            if not at[0].isdigit():
                found, wanted = FACTS[at](self, words)
                assert found == wanted, line
                continue
            heard = self.do(float(at), words)
            if arrow:
                assert alike(heard, spelled(expected)), f"{line}: {heard}"
        return self

    def _pass(self, until_ms: float) -> list[str]:
        """Let time pass as the service does: each deadline gets a step."""
        heard: list[str] = []
        while self.due_ms is not None and self.due_ms <= until_ms:
            heard += self.time(self.due_ms)
        return heard

    def time(self, at_ms: float) -> list[str]:
        return self.take(at_ms, events.TimePassed())

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
        """Take a request of a button: `register` by a name, which is its token, too (with a certificate, its holder's
        before it); `alive` and `leave` by that token."""
        do, token = cast("Any", verb), who if holder is None else f"{holder}: {who}"
        return self.take(at_ms, events.ButtonRequest(do, _ns(at_ms), who, holder, counts, token, count, sent_ms, token))

    def next_number(self) -> int:
        """Return the number of the next request that is answered by its number."""
        self._number += 1
        return self._number

    # ---- what came of it

    @property
    def joining(self) -> list[events.Transmit]:
        """Return the latest step's Stops to legs at rest that leave with its first Stops."""
        return [effect for effect in self.effects if isinstance(effect, events.Transmit) and effect.joins]

    def only(self, kind: type[T]) -> T:
        """Return the only effect of this kind of the latest step."""
        (found,) = [effect for effect in self.effects if isinstance(effect, kind)]
        return found

    @property
    def announced(self) -> list[events.Announce]:
        """Return the events of the latest step."""
        return [effect for effect in self.effects if isinstance(effect, events.Announce)]

    @property
    def detail(self) -> str:
        """Return the sentence of the only rejection of the latest step."""
        return self.only(events.Rejected).detail

    @property
    def due_ms(self) -> float | None:
        """Return the supervisor's next deadline."""
        due_ns = self.supervisor.due_ns
        return None if due_ns is None else due_ns / NS_PER_MS - 60_000

    @property
    def running(self) -> list[int]:
        return [servo.servo_id for servo in self.supervisor.legs.servos.values() if servo.running]


def _written(event: events.Announce) -> events.Announce:
    """Return an event whose step's frames are written."""
    found = event.outcome((), None)
    assert found is not None
    return found


def play(scene: str) -> Scenes:
    """Play a scene with a new robot."""
    lines = lines_of(scene)
    rules = rules_of(lines.pop(0).removeprefix("rules")) if lines[0].startswith("rules ") else None
    opened = lines[:1] != ["unopened"]
    return Scenes(rules, opened=opened).play("\n".join(lines if opened else lines[1:]))


def scene_test(scenes: Mapping[str, str], before: str = "") -> Callable[[str], None]:
    """Return a test that plays each of these scenes with a new robot, behind the lines `before`."""

    @pytest.mark.parametrize("scene", scenes.values(), ids=scenes)
    def test_a_scene(scene: str) -> None:
        play(before + scene)

    return test_a_scene


def lines_of(scene: str) -> list[str]:
    """Return a scene's lines, each with what it expects."""
    return [line for each in re.sub(r"\n\s*→", " →", scene).splitlines() if (line := each.strip())]


def rules_of(words: str) -> Rules:
    """Read `repeats=2, period_ms=1000`. By default Stops are not repeated, as in Scenes."""
    return Rules(**{"repeats": 0, "rest_runs": 0, **settings_of(words, "ms", NS_PER_MS)})


def spelled(expected: str) -> list[str]:
    """Return the effects that a line expects, in words."""
    items = [item.strip() for item in expected.split(";")]
    found: list[str] = []
    for item in items if items != ["nothing"] else []:
        cause, of_all, _ = item.partition(" 1-6 stop")
        found += all_stopped(cause) if of_all else [item]
    return found


def alike(said: Sequence[str], expected: Sequence[str]) -> bool:
    """Return whether a step's effects are the expected ones, with anything for `…`."""
    if not expected:
        return not said
    first, *rest = expected
    if first == "…":
        return any(alike(said[place:], rest) for place in range(len(said) + 1))
    return bool(said) and said[0] == first and alike(said[1:], rest)


def ids(words: str) -> tuple[int, ...]:
    return () if words == "none" else SERVO_IDS if words == "all" else tuple(map(int, words.split()))


def _board(_: Scenes, words: str, options: Options) -> events.PowerSeen:
    """Read `board`, `board silent`, and as options `fed 31 33`, `lost 32`, `taken 32`, `refused 12` (for overcurrent),
    `drew 31`, `supplied 31`, `doubt why`, `rests no` (by default a powered servo was seen at rest)."""
    refused = tuple((servo_id, "overcurrent") for servo_id in ids(options.get("refused", "none")))
    fed, lost = (frozenset(ids(options.get(name, usual))) for name, usual in (("fed", "all"), ("lost", "none")))
    drew = tuple((servo_id, "it draws current") for servo_id in ids(options.get("drew", "none")))
    taken, supplied = (frozenset(ids(options.get(name, "none"))) for name in ("taken", "supplied"))
    doubt, rests = options.get("doubt", ""), "rests" not in options
    return events.PowerSeen(words != "silent", refused, fed, lost, doubt, taken, supplied, drew, rests)


def _body(_: Scenes, words: str, options: Options) -> events.BodyMeasured:
    """Read `body 31` (its tilt in degrees), `body unknown`, `body 0 (battery 6.9)`."""
    tilt_cdeg = None if words == "unknown" else round(float(words) * 100)
    return events.BodyMeasured(tilt_cdeg, round(float(options.get("battery", 7.4)) * 1000))


def _lease(_robot: Scenes, words: str, options: Options) -> events.LeaseRequest:
    """Read `lease acquire anna (fresh token)`, `lease renew (token token)`, `lease release to bert (token token)`."""
    verb, _, name = words.partition(" ")
    to = name.removeprefix("to ") if name.startswith("to ") else None
    source = name if name and to is None else None
    token, fresh = options.get("token"), options.get("fresh", "")
    return events.LeaseRequest(cast("Any", verb), source, token=token, to=to, fresh_token=fresh)


def change_of(words: str) -> CalibrationCommand:
    """Read `32 trim -5 inverted + 33 trim 1 + landing 31 45`, or `nothing`; degrees."""
    servos: dict[str, ServoChange] = {}
    landing: dict[str, float] = {}
    for each in words.split(" + ") if words != "nothing" else ():
        of, value, *more = each.split()
        if of == "landing":
            landing[value] = float(more[0])
        else:
            servos[of] = ServoChange.model_construct(trim_deg=float(more[0]), inverted="inverted" in more or None)
    return CalibrationCommand.model_construct(servos=servos, landing=landing)


def _calibrate(robot: Scenes, words: str, options: Options) -> events.Calibrate:
    """Read `calibrate 32 trim -5 (revision 1, lease anna)`, `calibrate nothing (accept default)`."""
    revision = int(options["revision"]) if "revision" in options else None
    change = change_of(words).model_copy(update={"revision": revision, "accept_default": "accept" in options or None})
    event = events.Calibrate(number=robot.next_number(), change=change, lease=options.get("lease"))
    event.source, event.key = "anna", "hexapod/calibration/cmd"
    return event


def _kept(robot: Scenes, fault: str, _: Options) -> events.CalibrationSaved:
    """Return the disk's answer to the latest change."""
    saving = robot.supervisor.calibrating.saving
    return events.CalibrationSaved(0 if saving is None else saving[0].number, fault or None)


def _reset(robot: Scenes, newer: str, options: Options) -> events.Reset:
    """Return a reset that names the latest emergency stop, or one that is this much newer (older, if negative)."""
    estop = robot.supervisor.latch.number + int(newer or 0)
    return events.Reset(number=robot.next_number(), estop=estop, lease=options.get("lease"))


STEPS: Final[dict[str, Callable[[Scenes, str, Options], events.Event]]] = {
    "time": lambda *_: events.TimePassed(),
    "estop": lambda *_: events.EmergencyStop("somebody"),
    "reset": _reset,
    "unnumbered": lambda robot, *_: events.Reset(number=robot.next_number()),
    "fail": lambda _, kind, __: events.BusFailed("EIO", Kind(kind or Kind.BUS_FAULT)),
    "open": lambda *_: events.BusOpened(),
    "end": lambda *_: events.ShutDown(),
    "outside": lambda _, what, __: events.StoppedOutside({"begins": True, "ends": False}[what]),
    "disk": lambda _, number, __: events.EstopKept(int(number), engaged=False),
    "body": _body,
    "board": _board,
    "lease": _lease,
    "calibrate": _calibrate,
    "kept": _kept,
}
"""The events, by their first word."""


def _instant(robot: Scenes, words: str) -> tuple[object, object]:
    robot.instant_ms = None if words == "ends" else float(words)
    return None, None


FACTS: Final[dict[str, Callable[[Scenes, str], tuple[object, object]]]] = {
    "instant": _instant,  # what follows came in the instant that began then
    "running": lambda robot, words: (tuple(robot.running), ids(words)),
    "due": lambda robot, words: (robot.due_ms, None if words == "never" else float(words)),
    "mode": lambda robot, word: (robot.supervisor.mode, word),
    "says": lambda robot, detail: (robot.detail, detail),
    "supply": lambda robot, words: ("; ".join(robot.supply), words),
    "announces": lambda robot, detail: (robot.only(events.Announce).detail, detail),
    "mentions": lambda robot, words: (words in str(robot.effects), True),
    "legs": lambda robot, numbers: (robot.only(events.Announce).legs, tuple(map(int, numbers))),
    "joined": lambda robot, legs: (
        [effect.frame.servos[0][0] // 10 for effect in robot.joining],
        [*map(int, legs.replace("none", ""))],
    ),
    "expirations": lambda robot, count: (robot.supervisor.watchdog.expirations, int(count)),
    "pending": lambda robot, _: (pending(robot.supervisor), {}),
    "answers": lambda robot, detail: (robot.only(events.RequestAnswer).detail, detail),
    "halted": lambda robot, words: ("; ".join(each.detail for each in robot.halted), words),
    "source": lambda robot, name: (robot.only(events.Announce).source, name),
    "key": lambda robot, key: (robot.only(events.Announce).key, key),
    "asked": lambda robot, name: (robot.supervisor.lease.asked_by or "nobody", name),
    "holder": lambda robot, name: (robot.supervisor.lease.holder or "nobody", name),
    "watchdogs": lambda robot, words: ([leg.watchdog for leg in robot.supervisor.legs], words.split()),
}
"""The facts after the latest step, by their first word: what is found, and what is wanted."""
