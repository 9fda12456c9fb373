"""The small robots of the model check: their rules, and what may be asked of them; commands and settings in words."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Final

from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import STOP, Op, ServoOp, servo_ids_of
from gateway.rate_limit import NS_PER_S
from gateway.robot.core.events import PowerSeen
from gateway.robot.core.rules import Rules
from schemas.calibration import CalibrationCommand, ServoChange

TICK: Final = 10
"""Nanoseconds, in a world where a leg's period is two ticks, or four, of which a quarter is one."""

Targets = tuple[tuple[int, ServoOp], ...]


# ---- in words


def targets_of(words: str) -> Targets:
    """Read `leg 1 start 90`, `leg 1 set 80 | stop | set 70`, `servo 11,21 stop`, `legs 123 stop`; ` + ` joins them."""
    found: Targets = ()
    for each in words.split(" + "):
        of, numbers, word = each.strip().split(" ", 2)
        if of == "servo":
            servo_ids = [int(number) for number in numbers.split(",")]
        else:
            servo_ids = [servo_id for leg in numbers for servo_id in servo_ids_of(int(leg))]
        ops = [op_of(part.strip()) for part in word.split("|")]  # one is for all
        found += tuple(zip(servo_ids, ops * (len(servo_ids) // len(ops)), strict=True))
    return found


def op_of(word: str) -> ServoOp:
    """Read `start 90`, `set 45.5` or `stop`."""
    name, _, angle = word.partition(" ")
    return STOP if name == "stop" else ServoOp(Op[name.upper()], round(float(angle) * 100))


def settings_of(words: str, unit: str, unit_ns: int) -> dict[str, Any]:
    """Read `repeats=2, period_ms=1000`. A time in this unit, or several, becomes nanoseconds: `period_ns`."""
    call = ast.parse(f"settings({words})", mode="eval").body
    assert isinstance(call, ast.Call)
    found: dict[str, Any] = {}
    for each in call.keywords:
        name, value = str(each.arg), ast.literal_eval(each.value)
        if name.endswith(f"_{unit}"):
            name = name.removesuffix(unit) + "ns"
            value = _scaled(value, unit_ns)
        found[name] = value
    return found


def _scaled(value: Any, unit_ns: int) -> Any:
    if isinstance(value, dict):
        return {key: _scaled(each, unit_ns) for key, each in value.items()}
    return tuple(_scaled(each, unit_ns) for each in value) if isinstance(value, tuple) else round(value * unit_ns)


# ---- what a robot is


@dataclass(frozen=True, slots=True)
class Configuration:
    """A small robot, its rules, what may be asked of it, and how far apart events may be (in nanoseconds)."""

    name: str
    rules: Rules
    commands: tuple[tuple[str, Targets], ...]
    """(channel, targets)"""
    waits_ns: tuple[int, ...] = (TICK, 3 * TICK)
    within_ns: tuple[int, ...] = ()
    """How far apart events of one instant may be: handling those before them takes time."""
    drivers: tuple[str, ...] = ()
    """Who wants the lease."""
    buttons: tuple[str, ...] = ()
    """Who wants to be a button."""
    delays_ns: tuple[int, ...] = ()
    """How long a button's message that states when it was sent may have been on its way."""
    calibration: RobotCalibration | None = None
    """The calibration at the start."""
    fault: str | None = None
    """Why this calibration cannot be trusted."""
    changes: tuple[CalibrationCommand, ...] = ()
    """The changes of the calibration that may be asked for."""
    bodies: tuple[tuple[int | None, int], ...] = ()
    """What the robot may measure: (tilt in hundredths of a degree, battery in mV)."""
    boards: tuple[PowerSeen, ...] = ()
    """The reports that may come from the power board."""
    unread: tuple[Targets, ...] = ()
    """Stops that may be in a message that cannot be read."""
    calm: bool = True
    """Whether the bus answers, and nobody wants an emergency stop or stops servos past the gateway."""
    ends: bool = False
    """Whether the service may be shut down, too; such a robot is not calm."""

    @property
    def legs(self) -> list[int]:
        """Return the legs that its commands name; the robot has no others."""
        return sorted({servo_id // 10 for _, targets in self.commands for servo_id, _ in targets})


_RULES: Final = Rules(
    timeout_ns=4 * TICK,
    repeats=0,
    repeat_interval_ns=TICK,
    rest_ns=3 * TICK,
    rest_runs=0,
    rest_run_ns=3 * TICK,
    period_ns=2 * TICK,
    unnumbered_reset_ns=2 * TICK,
    # For robots with `start_wait_ticks`:
    apart_ns=TICK // 2,
    silence_ns=2 * TICK,
    proof_ns=5 * TICK,
    quiet_ns=4 * TICK,
    most_clumped=4,
)
_MIRRORED: Final = RobotCalibration(1, {11: ServoMapping(-10_00, inverted=True)}, {11: 20_00})
_CHANGES: Final = {
    "drawn": CalibrationCommand(servos={"11": ServoChange(trim_deg=0.0, inverted=False, max_deg=180.0)}, landing={}),
    "limited": CalibrationCommand(
        servos={"11": ServoChange(trim_deg=-10.0, inverted=True, max_deg=15.0)}, landing={"11": None}
    ),
    "impossible": CalibrationCommand.model_construct(
        servos={"11": ServoChange.model_construct(trim_deg=90.01)}, landing={}
    ),
}
"""Servo 11 is then as drawn, so that any angle is allowed; or limited below 20 degrees; or not possible."""
_FED: Final = PowerSeen(alive=True, fed=frozenset({11, 12, 21}), rests=True)
_BOARDS: Final = {
    "fed": _FED,
    "fed, not at rest": replace(_FED, rests=False),
    "feeds 11": replace(_FED, fed=frozenset({11})),
    "feeds 11 anew": replace(_FED, supplied=frozenset({11})),
    "alive": PowerSeen(alive=True),
    "silent": PowerSeen(alive=False),
    "blocked": PowerSeen(alive=True, refused=((11, "overcurrent"),), lost=frozenset({11})),
    "doubt": PowerSeen(alive=True, doubt="it is not confirmed"),
    "lost 11": PowerSeen(alive=True, lost=frozenset({11})),
    "lost 12": PowerSeen(alive=True, lost=frozenset({12})),
    "12 taken": PowerSeen(alive=True, lost=frozenset({12}), taken=frozenset({12})),
    "11 draws": PowerSeen(alive=True, drew=((11, "it draws"),)),
    "12 draws": PowerSeen(alive=True, drew=((12, "it draws"),)),
}
_TABLE: Final = """
one servo, two channels
    put: servo 11 start 10; put: servo 11 set 20; put: servo 11 stop; get: servo 11 start 10; get: servo 11 set 20;
    get: servo 11 stop
    repeats=2, waits_ticks=(0, 1, 5), ends=True
one servo, starts without a time
    leg: servo 11 start 10; leg: servo 11 set 20; leg: servo 11 stop; leg with a time: servo 11 start 10
    start_wait_ticks=1, waits_ticks=(0, 1, 5)
two legs, starts without a time
    legs: servo 11,21 start 10; leg: servo 21 start 10; leg with a time: servo 21 set 20
    start_wait_ticks=1, waits_ticks=(0, 2)
two legs that start as one, without a time
    legs 12 start 10; servo 21 set 20; servo 11 stop
    start_wait_ticks=1, starts_whole=True, waits_ticks=(0, 2)
two legs, started one after the other without a time
    legs: servo 11,21 start 10; servo 11 stop
    start_pause_ticks=3, start_wait_ticks=1, waits_ticks=(0, 2)
one leg, and what cannot be read
    leg 1 start 10; leg: servo 11 stop + servo 12,13 set 20
    repeats=1, waits_ticks=(0, 1, 5), unread=("leg 1 stop", "servo 11 stop"), calm=False
one servo, instants in which time passes
    put: servo 11 start 10; put: servo 11 set 20; put: servo 11 stop; get: servo 11 start 10; get: servo 11 stop
    waits_ticks=(0, 1, 5), within_ticks=(1,), calm=False
one leg, commands for all of it and for a servo
    leg 1 start 10; leg 1 set 20; leg 1 stop; leg: servo 11 stop + servo 12,13 start 10; servo 11 start 10;
    servo 11 stop
    repeats=1, waits_ticks=(0, 1, 5), calm=False
one leg, its joints apart
    put servo: servo 12 start 10; put servo: servo 13 start 10; put servo: servo 12 stop; put servo: servo 13 stop;
    put leg: servo 11,12 stop + servo 13 set 20
    waits_ticks=(0, 1, 5), calm=False
one leg, frames a quarter of a period apart
    servo 11 start 10; servo 11 set 20; servo 11 stop
    timeout_ticks=6, period_ticks=4, waits_ticks=(0, 1, 5, 4), calm=False
a rate slot later than the watchdog
    leg 1 start 10; leg 1 set 20; leg 1 stop; leg: servo 11 stop + servo 12,13 start 10; servo 11 start 10;
    servo 11 stop
    timeout_ticks=2, repeats=1, period_ticks=3, waits_ticks=(1, 5), ends=True
two legs
    servo 11 stop; servo 21 start 10; servo 21 stop; legs: servo 11,21 start 10;
    legs: servo 11 start 10 + servo 21 stop
    waits_ticks=(1, 5), calm=False
two legs, more runs of Stops at rest
    servo 11 start 10; servo 11 stop; servo 21 stop
    rest_runs=1, ends=True
two legs, repeated Stops
    servo 11 start 10; servo 11 stop; servo 21 start 10; servo 21 stop
    repeats=1, waits_ticks=(1, 5), calm=False
two legs, rate slots later than the watchdog
    legs: servo 11,21,22 start 10; servo 21 start 10; servo 11 stop
    timeout_ticks=2, period_ticks=3, calm=False
two legs, one silent leg stops both
    servo 11 start 10; servo 11 stop; servo 21 start 10; servo 21 stop; legs: servo 11,21 start 10;
    legs: servo 11 start 10 + servo 21 stop
    whole_robot=True, waits_ticks=(1, 5), calm=False
one servo, and an emergency stop that outlasts the gateway
    servo 11 start 10; servo 11 stop
    timeout_ticks=2, estop_kept=True, waits_ticks=(0, 3), ends=True
two drivers and one lease
    servo 11 start 10; servo 11 stop
    timeout_ticks=2, lease_ttl_ticks=3, drivers=("anna", "bert")
a lease that must be held, and whatever else may happen
    servo 11 start 10; servo 11 stop
    timeout_ticks=2, lease_required=True, lease_ttl_ticks=3, drivers=("anna",), ends=True
two buttons, one of which must be alive
    servo 11 start 10
    timeout_ticks=2, buttons_required=1, buttons_timeout_ticks=3, waits_ticks=(1, 4), buttons=("kitchen", "door")
one button whose messages may be late
    servo 11 start 10; servo 11 stop
    buttons_required=1, buttons_timeout_ticks=3, waits_ticks=(1, 4), buttons=("kitchen",), delays_ticks=(0, 1, 3)
a button that must be alive, and whatever else may happen
    servo 11 start 10; servo 11 stop
    timeout_ticks=2, buttons_required=1, buttons_timeout_ticks=2, buttons=("kitchen",), ends=True
two legs, landing, and a button that must be alive
    legs: servo 11,21 start 10; servo 21 stop
    landing_ticks=8, landing_cdeg={11: 20_00}, buttons_required=1, buttons_timeout_ticks=3, waits_ticks=(1, 4),
    buttons=("kitchen",)
two legs that start and stop as one
    legs 12 start 10; legs 12 stop; servo 11 start 10; servo 21 set 20; servo 11 stop;
    leg: servo 11 stop + servo 12 start 10
    starts_whole=True, waits_ticks=(1, 5), unread=("servo 11 stop",), ends=True
two legs that start and stop as one, rate slots later than the watchdog, and landing
    legs 12 start 10; servo 21 set 20; servo 11 stop
    timeout_ticks=2, period_ticks=3, landing_ticks=4, starts_whole=True, calm=False
two legs that start and stop as one, and a lease
    legs 12 start 10; servo 21 set 20; leg: servo 11 stop + servo 12 start 10
    timeout_ticks=3, period_ticks=3, lease_ttl_ticks=3, starts_whole=True, drivers=("anna",)
one servo, a battery and a body that may fall
    servo 11 start 10; servo 11 set 20; servo 11 stop
    min_battery_mv=5000, max_tilt_cdeg=30_00, tilt_ticks=2, bodies=((0, 7000), (0, 5050), (31_00, 4999), (None, 7000)),
    ends=True
two legs that start and stop as one, landing, and a body that may fall
    legs 12 start 10; servo 21 stop
    landing_ticks=6, starts_whole=True, max_tilt_cdeg=30_00, tilt_ticks=2, bodies=((30_00, 0), (31_00, 0), (None, 0))
one servo, and a board that feeds it
    servo 11 start 10; servo 11 set 20; servo 11 stop
    timeout_ticks=2, period_ticks=3, power=True, feed_ticks=4, waits_ticks=(0, 1, 3),
    boards=("fed", "silent", "blocked"), calm=False
one servo, and a board that does not confirm
    servo 11 start 10; servo 11 set 20; servo 11 stop
    timeout_ticks=2, period_ticks=3, power=True, feed_ticks=4, waits_ticks=(0, 1, 3), boards=("fed", "alive", "doubt"),
    calm=False
two legs, landing, and a board that feeds them
    legs: servo 11,21 start 10; servo 12 start 10; servo 21 stop
    landing_ticks=6, landing_cdeg={11: 20_00}, power=True, feed_ticks=3,
    boards=("fed", "feeds 11", "silent", "lost 11", "doubt")
two servos of a leg, and a board whose supply starts each
    leg: servo 11,12 start 10; leg: servo 11 stop + servo 12 start 10; servo 12 set 20; servo 11 stop
    timeout_ticks=3, power=True, angles_first=True, feed_ticks=4, boards=("fed", "silent", "feeds 11", "lost 12")
two servos of a leg, whose currents show whether they obey
    leg: servo 11,12 start 10; servo 11 stop
    timeout_ticks=3, power=True, feed_ticks=4,
    boards=("fed", "fed, not at rest", "feeds 11 anew", "11 draws", "12 draws", "12 taken"), calm=False
two legs, started one after the other
    servo 11 start 10; servo 11 stop; servo 21 start 10; legs: servo 11,21 start 10
    start_pause_ticks=3, waits_ticks=(1, 5), calm=False
one leg, a limited speed
    servo 11 start 0; servo 11 set 180; servo 11 stop; leg: servo 11 set 0 + servo 12 start 10
    max_speed_ticks={11: 5}
two legs, a limited speed, started one after the other
    servo 11 start 0; legs: servo 11 set 180 + servo 21 start 10; servo 22 stop
    timeout_ticks=5, start_pause_ticks=4, max_speed_ticks={11: 8}
one servo, angles that are never sent, and a limited speed
    servo 11 start 0; servo 11 set 180; servo 11 set 90
    avoid_cdeg=(40_00, 130_00), max_speed_ticks={11: 8}
one leg, angles that are never sent, and landing
    leg: servo 11 start 0 + servo 12 start 10; leg: servo 11 set 150 + servo 12 start 10; put: servo 11 stop;
    get: servo 11 start 10
    avoid_cdeg=(40_00, 130_00), landing_ticks=8, landing_cdeg={11: 180_00, 12: 90_00}, waits_ticks=(0, 1, 3)
two legs, landing
    servo 11 start 10; servo 11 stop; servo 21 start 10; servo 21 stop; legs: servo 11,21 set 20
    landing_ticks=8, landing_cdeg={11: 20_00}, ends=True
one leg, a servo of which is calibrated
    servo 11 start 10; servo 11 stop; leg: servo 11 set 20 + servo 12 start 10
    timeout_ticks=2, waits_ticks=(1, 4), calibrated=True, changes=("drawn", "limited"), calm=False
one servo, calibrated and limited in speed, and landing
    servo 11 start 10; servo 11 set 20; servo 11 stop
    joint_limits_cdeg={11: (0, 100_00)}, max_speed_ticks={11: 20}, landing_ticks=4, landing_cdeg={11: 90_00},
    waits_ticks=(0, 1, 3), calibrated=True, changes=("limited", "impossible")
one servo, calibrated by its driver
    servo 11 start 10
    timeout_ticks=2, lease_ttl_ticks=3, drivers=("anna",), calibrated=True, changes=("drawn",)
one servo, whose calibration cannot be read
    servo 11 start 10; servo 11 set 20; servo 11 stop; leg: servo 11 set 20 + servo 12 start 10
    waits_ticks=(1, 5), calibrated=True, fault="it is broken", changes=("limited", "impossible"), ends=True
one leg, a limited speed and landing
    servo 11 start 0; servo 11 set 90; servo 11 stop
    max_speed_ticks={11: 5}, landing_ticks=5, landing_cdeg={11: 180_00}, calm=False
one servo, two programs that take it from each other
    servo 11 start 0; servo anna's: servo 11 set 180; leg anna's: servo 11 start 180 + servo 12 start 10;
    servo 11 stop
    takeover_ticks=6, takeover_known_ticks=2
one servo, started again soon, and calibrated meanwhile
    servo 11 start 150; servo 11 start 30; servo 11 stop
    timeout_ticks=2, takeover_ticks=6, takeover_known_ticks=3, calibrated=True, changes=("drawn",)
two servos of a leg, of which one waits for its supply while the other is taken over
    leg: servo 11,12 start 0; servo 11 stop; servo anna's: servo 11 start 90
    timeout_ticks=3, period_ticks=1, takeover_ticks=2, takeover_known_ticks=2, power=True, feed_ticks=2,
    waits_ticks=(1,), boards=("fed",)
one servo, taken over, and landing
    servo 11 start 150; servo anna's: servo 11 set 30; servo 11 stop
    takeover_ticks=8, takeover_known_ticks=1, landing_ticks=4, landing_cdeg={11: 90_00}
one servo, started again soon, whatever else may happen
    servo 11 start 0; servo anna's: servo 11 start 90; servo 11 stop
    timeout_ticks=2, takeover_ticks=6, takeover_known_ticks=2, ends=True
"""
"""A robot's name, and below it its commands and its settings.

A command has its channel before it (`servo anna's: servo 11 stop`), unless that is its first word. A setting is a rule
or a field of Configuration. A speed is the time for 180 degrees: `max_speed_ticks` for some servos, `takeover_ticks`.
"""


def _robots() -> Iterator[Configuration]:
    for name, lines in re.findall(r"^(\S.*)\n((?: .*\n)+)", _TABLE, re.MULTILINE):
        parts = [line.strip() for line in lines.splitlines()]
        commands = " ".join(part for part in parts if "=" not in part)
        yield _robot(name, commands, " ".join(part for part in parts if "=" in part))


def _robot(name: str, commands: str, words: str) -> Configuration:
    settings = settings_of(words, "ticks", TICK)
    if takeover_ns := settings.pop("takeover_ns", None):
        settings["takeover_cdeg_s"] = 180_00 * NS_PER_S // takeover_ns
    speeds = settings.pop("max_speed_ns", {})
    settings["max_speed_cdeg_s"] = {servo_id: 180_00 * NS_PER_S // for_ns for servo_id, for_ns in speeds.items()}
    if settings.pop("calibrated", False):
        settings["calibration"] = _MIRRORED
    settings["changes"] = tuple(_CHANGES[each] for each in settings.pop("changes", ()))
    settings["boards"] = tuple(_BOARDS[each] for each in settings.pop("boards", ()))
    settings["unread"] = tuple(map(targets_of, settings.pop("unread", ())))
    own = {each.name for each in fields(Configuration)}
    rules = replace(_RULES, **{rule: value for rule, value in settings.items() if rule not in own})
    pairs = [each.rpartition(": ")[::2] for each in commands.split("; ")]
    asked = tuple((channel or targets.split()[0], targets_of(targets)) for channel, targets in pairs)
    return Configuration(name, rules, asked, **{field: value for field, value in settings.items() if field in own})


CONFIGURATIONS: Final = tuple(_robots())
