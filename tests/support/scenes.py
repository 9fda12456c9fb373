"""Scenes for a supervisor as text: a line is an instant, what comes then, and what the step says.

    100 leg 1 start 90 → command 1 start 90; completed 1
    120 servo 12 set 45 (lease anna) → nothing
    due 350
    350 time → …; announce watchdog_expired  # why it is so

`…` stands for anything, `estop 1-6 stop` for a Stop to each leg. A line without an instant is a fact (FACTS). A long
line continues in the next one, from its arrow on. A first line `rules repeats=2, start_pause_ms=50` states the rules
(otherwise those of Steps), and `unopened` that the bus is not open yet.
"""

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Announce, Command, RequestAnswer
from gateway.robot.core.leg import Rules
from schemas.calibration import CalibrationCommand, ServoChange
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind
from tests.support.model_check import pending
from tests.support.steps import Steps, Targets, all_stopped, leg_to, legs_to, servo_to


class Scenes(Steps):
    """A supervisor that scenes are played with."""

    def play(self, scene: str) -> "Scenes":
        """Take each line of it."""
        for line in lines_of(scene):
            done, arrow, expected = line.partition("  #")[0].partition("→")
            at, _, words = done.strip().partition(" ")
            if not at[0].isdigit():
                found, wanted = FACTS[at](self, words)
                assert found == wanted, line
                continue
            said = take(self, float(at), words)
            if arrow:
                assert alike(said, spelled(expected)), f"{line}: {said}"
        return self


def play(scene: str) -> Scenes:
    """Play it with a new robot."""
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
    """Its lines, each with what it expects."""
    return [line for each in re.sub(r"\n\s*→", " →", scene).splitlines() if (line := each.strip())]


def rules_of(words: str) -> Rules:
    """`repeats=2, period_ms=1000`; without a word of them, Stops are not repeated, as in Steps."""
    call = ast.parse(f"rules({words})", mode="eval").body
    assert isinstance(call, ast.Call)
    known: dict[str, Any] = {"repeats": 0, "rest_runs": 0}
    for each in call.keywords:
        name, value = str(each.arg), ast.literal_eval(each.value)
        known |= {f"{name[:-3]}_ns": round(value * NS_PER_MS)} if name.endswith("_ms") else {name: value}
    return Rules(**known)


def spelled(expected: str) -> list[str]:
    """What a step is to say."""
    items = [item.strip() for item in expected.split(";")]
    found: list[str] = []
    for item in items if items != ["nothing"] else []:
        cause, of_all, _ = item.partition(" 1-6 stop")
        found += all_stopped(cause) if of_all else [item]
    return found


def alike(said: Sequence[str], expected: Sequence[str]) -> bool:
    """Whether a step said this, with anything for `…`."""
    if not expected:
        return not said
    first, *rest = expected
    if first == "…":
        return any(alike(said[place:], rest) for place in range(len(said) + 1))
    return bool(said) and said[0] == first and alike(said[1:], rest)


def targets_of(words: str) -> Targets:
    """`leg 1 start 90`, `leg 1 set 80 | stop | set 70`, `servo 11 stop`, `legs 123 stop`, and these joined by `+`."""
    found: Targets = ()
    for each in words.split(" + "):
        of, number, word = each.strip().split(" ", 2)
        match of:
            case "leg":
                found += leg_to(int(number), *(part.strip() for part in word.split("|")))
            case "legs":
                found += legs_to(number, word)
            case _:
                found += servo_to(int(number), word)
    return found


def take(robot: Steps, at_ms: float, words: str) -> list[str]:
    """One step; its options stand in parentheses: `(lease anna, key legs)`. `lost leg 2 stop`: messages were lost, and
    one may have been this. `timed leg 2 start 90`: it has its time, on a key of its own."""
    words, _, rest = words.partition(" (")
    options = dict(option.strip().split(" ", 1) for option in rest.rstrip(") ").split(",") if option)
    what, _, more = words.strip().partition(" ")
    if what in ("leg", "legs", "servo"):
        channel = options.pop("key", "leg")
        return robot.command(at_ms, targets_of(words), channel, **options)
    if what in ("lost", "timed"):
        lost, sent_ms = what == "lost", None if what == "lost" else 1
        return robot.take(at_ms, Command(targets_of(more), key=what, number=99, lost=lost, sent_ms=sent_ms))
    return STEPS[what](robot, at_ms, more, options)


def _board(robot: Steps, at_ms: float, words: str, options: dict[str, str]) -> list[str]:
    """`board`, `board silent`, and as options `fed 31 33`, `lost 32`, `refused 12`, `doubt why`."""
    known: dict[str, Any] = {"alive": words != "silent"}
    known |= {name: value if name in ("doubt", "refused") else ids(value) for name, value in options.items()}
    return robot.board(at_ms, **known)


def ids(words: str) -> tuple[int, ...]:
    return () if words == "none" else SERVO_IDS if words == "all" else tuple(map(int, words.split()))


def _body(robot: Steps, at_ms: float, words: str, options: dict[str, str]) -> list[str]:
    """`body 31` (its tilt in degrees), `body unknown`, `body 0 (battery 6.9)`."""
    tilt_deg = None if words == "unknown" else float(words)
    return robot.measure(at_ms, tilt_deg, float(options.get("battery", 7.4)))


def _lease(robot: Steps, at_ms: float, words: str, options: dict[str, str]) -> list[str]:
    """`lease acquire anna (fresh token)`, `lease renew (token token)`."""
    return robot.lease(at_ms, words, options.get("token"), fresh=options.get("fresh", ""))


def _button(robot: Steps, at_ms: float, words: str, options: dict[str, str]) -> list[str]:
    """`button register kitchen`, `button alive kitchen 1 (sent 55020, holder anna's)`."""
    verb, who, *count = words.split()
    sent_ms = float(options["sent"]) if "sent" in options else None
    return robot.button(at_ms, verb, who, *map(int, count), sent_ms=sent_ms, holder=options.get("holder"))


def change_of(words: str) -> CalibrationCommand:
    """`32 trim -5 inverted + 33 trim 1 + landing 31 45`, or `nothing`; degrees."""
    servos: dict[str, ServoChange] = {}
    landing: dict[str, float] = {}
    for each in words.split(" + ") if words != "nothing" else ():
        of, value, *more = each.split()
        if of == "landing":
            landing[value] = float(more[0])
        else:
            servos[of] = ServoChange.model_construct(trim_deg=float(more[0]), inverted="inverted" in more or None)
    return CalibrationCommand.model_construct(servos=servos, landing=landing)


def _calibrate(robot: Steps, at_ms: float, words: str, options: dict[str, str]) -> list[str]:
    """`calibrate 32 trim -5 (revision 1, lease anna)`, `calibrate nothing (accept default)`."""
    revision = int(options["revision"]) if "revision" in options else None
    default, lease = "accept" in options, options.get("lease")
    return robot.calibrate(at_ms, change_of(words), revision=revision, accept_default=default, lease=lease)


def _pass(robot: Steps, until_ms: float) -> list[str]:
    """Let time pass as the service does: whatever is due is done when it is."""
    said: list[str] = []
    while robot.due_ms is not None and robot.due_ms <= until_ms:
        said += robot.time(robot.due_ms)
    return said


STEPS: Final[dict[str, Callable[[Steps, float, str, dict[str, str]], list[str]]]] = {
    "time": lambda robot, at_ms, _, __: robot.time(at_ms),
    "pass": lambda robot, at_ms, _, __: _pass(robot, at_ms),
    "estop": lambda robot, at_ms, _, __: robot.estop(at_ms),
    "reset": lambda robot, at_ms, newer, options: robot.reset(at_ms, newer=int(newer or 0), **options),
    "unnumbered": lambda robot, at_ms, _, __: robot.reset_without_number(at_ms),
    "fail": lambda robot, at_ms, kind, __: robot.fail(at_ms, Kind(kind or Kind.BUS_FAULT)),
    "open": lambda robot, at_ms, _, __: robot.open(at_ms),
    "end": lambda robot, at_ms, _, __: robot.end(at_ms),
    "outside": lambda robot, at_ms, what, _: robot.outside(at_ms, at_work={"begins": True, "ends": False}[what]),
    "body": _body,
    "board": _board,
    "lease": _lease,
    "button": _button,
    "calibrate": _calibrate,
    "kept": lambda robot, at_ms, fault, _: robot.kept(at_ms, fault or None),
}
"""What a step takes, by its first word."""


def _instant(robot: Steps, words: str) -> tuple[object, object]:
    robot.instant_ms = None if words == "ends" else float(words)
    return None, None


FACTS: Final[dict[str, Callable[[Steps, str], tuple[object, object]]]] = {
    "instant": _instant,  # what follows came in the instant that began then
    "running": lambda robot, words: (tuple(robot.running), ids(words)),
    "due": lambda robot, words: (robot.due_ms, None if words == "never" else float(words)),
    "mode": lambda robot, word: (robot.supervisor.mode, word),
    "says": lambda robot, detail: (robot.detail, detail),
    "announces": lambda robot, detail: (robot.only(Announce).detail, detail),
    "mentions": lambda robot, words: (words in str(robot.effects), True),
    "legs": lambda robot, numbers: (robot.only(Announce).legs, tuple(map(int, numbers))),
    "joined": lambda robot, legs: (
        [effect.frame.servos[0][0] // 10 for effect in robot.joining],
        [*map(int, legs.replace("none", ""))],
    ),
    "expirations": lambda robot, count: (robot.supervisor.watchdog.expirations, int(count)),
    "pending": lambda robot, _: (pending(robot.supervisor), {}),
    "answers": lambda robot, detail: (robot.only(RequestAnswer).detail, detail),
    "source": lambda robot, name: (robot.only(Announce).source, name),
    "key": lambda robot, key: (robot.only(Announce).key, key),
    "asked": lambda robot, name: (robot.supervisor.lease.asked_by or "nobody", name),
    "holder": lambda robot, name: (robot.supervisor.lease.holder or "nobody", name),
    "watchdogs": lambda robot, words: ([leg.watchdog for leg in robot.supervisor.legs], words.split()),
}
"""What is so behind the latest step, by its first word: found, and wanted."""
