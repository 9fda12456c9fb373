"""The small robots of the model check: their rules, and what may be asked of them."""

from dataclasses import dataclass, replace
from typing import Any, Final

from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import STOP, Op, ServoOp
from gateway.rate_limit import NS_PER_S
from gateway.robot.core.events import PowerSeen
from gateway.robot.core.rules import Rules
from schemas.calibration import CalibrationCommand, ServoChange

TICK: Final = 10
"""Nanoseconds, in a world where a leg's period is two ticks, or four, of which a quarter is one."""

Targets = tuple[tuple[int, ServoOp], ...]


@dataclass(frozen=True, slots=True)
class Configuration:
    """A small robot, its rules, what may be asked of it, and how far apart events may be (in nanoseconds)."""

    name: str
    rules: Rules
    commands: tuple[tuple[str, Targets], ...]
    """(channel, targets)"""
    waits_ns: tuple[int, ...] = (TICK, 3 * TICK)
    within_ns: tuple[int, ...] = ()
    """The same for events of the same instant: to deal with those before them takes time."""
    drivers: tuple[str, ...] = ()
    """Who wants the lease."""
    buttons: tuple[str, ...] = ()
    """Who wants to be a button."""
    delays_ns: tuple[int, ...] = ()
    """How long a button's message may have been on its way, where it says when it was sent."""
    calibration: RobotCalibration | None = None
    """What is in force at first."""
    fault: str | None = None
    """Why that cannot be trusted."""
    changes: tuple[CalibrationCommand, ...] = ()
    """What may be changed of the calibration."""
    bodies: tuple[tuple[int | None, int], ...] = ()
    """What the robot may measure: (tilt in hundredths of a degree, battery in mV)."""
    boards: tuple[PowerSeen, ...] = ()
    """What the power board may be seen to say."""
    unread: tuple[Targets, ...] = ()
    """Stops that may be in a message that cannot be read."""
    calm: bool = True
    """Whether the bus answers, and nobody wants an emergency stop or stops servos past the gateway."""
    ends: bool = False
    """Whether the service may be shut down, too; such a robot is not calm."""

    @property
    def legs(self) -> list[int]:
        """Those that its commands name; the robot has no others."""
        return sorted({servo_id // 10 for _, targets in self.commands for servo_id, _ in targets})


LOW, HIGH = 10_00, 20_00
START, SET = ServoOp(Op.START, LOW), ServoOp(Op.SET, HIGH)


def _rules(**changes: Any) -> Rules:
    defaults: dict[str, Any] = {
        "timeout_ns": 4 * TICK,
        "repeats": 0,
        "repeat_interval_ns": TICK,
        "rest_ns": 3 * TICK,
        "rest_runs": 0,
        "rest_run_ns": 3 * TICK,
        "period_ns": 2 * TICK,
        "unnumbered_reset_ns": 2 * TICK,
    }
    return Rules(**{**defaults, **changes})


_BURSTS: Final[dict[str, Any]] = {
    "start_wait_ns": TICK,
    "apart_ns": TICK // 2,
    "silence_ns": 2 * TICK,
    "proof_ns": 5 * TICK,
    "quiet_ns": 4 * TICK,
    "most_clumped": 4,
}


def _each(op: ServoOp, *servo_ids: int) -> Targets:
    return tuple((servo_id, op) for servo_id in servo_ids)


_ONE_SERVO = tuple((f"{verb} servo/11", _each(op, 11)) for verb in ("put", "get") for op in (START, SET, STOP))
_WHOLE_LEG = (
    *(("leg", _each(op, 11, 12, 13)) for op in (START, SET, STOP)),
    ("leg", ((11, STOP), (12, START), (13, START))),
    ("servo", _each(START, 11)),
    ("servo", _each(STOP, 11)),
)
_EACH_JOINT = (
    *(("put servo", _each(START, joint)) for joint in (12, 13)),
    *(("put servo", _each(STOP, joint)) for joint in (12, 13)),
    ("put leg", ((11, STOP), (12, STOP), (13, SET))),
)
_TWO_LEGS = (
    *(("servo", _each(op, leg)) for leg in (11, 21) for op in (START, STOP)),
    ("legs", _each(START, 11, 21)),
    ("legs", ((11, START), (21, STOP))),
)
_BOTH = (11, 12, 13, 21, 22, 23)
_WAITS = (0, TICK, 5 * TICK)
_MIRRORED = RobotCalibration(1, {11: ServoMapping(-10_00, inverted=True)}, {11: HIGH})
_RECALIBRATED = (
    CalibrationCommand(servos={"11": ServoChange(trim_deg=0.0, inverted=False, max_deg=180.0)}, landing={}),
    CalibrationCommand(servos={"11": ServoChange(trim_deg=-10.0, inverted=True, max_deg=15.0)}, landing={"11": None}),
    CalibrationCommand.model_construct(servos={"11": ServoChange.model_construct(trim_deg=90.01)}, landing={}),
)
"""What it then is: as drawn, so that any angle goes; with a limit below HIGH; and impossible."""

_FED, _ALIVE, _SILENT = (
    PowerSeen(alive=True, fed=frozenset({11, 12, 21}), rests=True),
    PowerSeen(alive=True),
    PowerSeen(alive=False),
)
_BLOCKED = PowerSeen(alive=True, refused=((11, "overcurrent"),), lost=frozenset({11}))
_DOUBT = PowerSeen(alive=True, doubt="it is not confirmed")

CONFIGURATIONS: Final = (
    Configuration("one servo, two channels", _rules(repeats=2), _ONE_SERVO, waits_ns=_WAITS, ends=True),
    Configuration(
        "one servo, starts without a time",
        _rules(**_BURSTS),
        (*(("leg", _each(op, 11)) for op in (START, SET, STOP)), ("leg with a time", _each(START, 11))),
        waits_ns=_WAITS,
    ),
    Configuration(
        "two legs, starts without a time",
        _rules(**_BURSTS),
        (("legs", _each(START, 11, 21)), ("leg", _each(START, 21)), ("leg with a time", _each(SET, 21))),
        waits_ns=(0, 2 * TICK),
    ),
    Configuration(
        "two legs that start as one, without a time",
        _rules(**_BURSTS, starts_whole=True),
        (("legs", _each(START, *_BOTH)), ("servo", _each(SET, 21)), ("servo", _each(STOP, 11))),
        waits_ns=(0, 2 * TICK),
    ),
    Configuration(
        "two legs, started one after the other without a time",
        _rules(**_BURSTS, start_pause_ns=3 * TICK),
        (("legs", _each(START, 11, 21)), ("servo", _each(STOP, 11))),
        waits_ns=(0, 2 * TICK),
    ),
    Configuration(
        "one leg, and what cannot be read",
        _rules(repeats=1),
        (("leg", _each(START, 11, 12, 13)), ("leg", ((11, STOP), (12, SET), (13, SET)))),
        waits_ns=_WAITS,
        unread=(_each(STOP, 11, 12, 13), _each(STOP, 11)),
        calm=False,
    ),
    Configuration(
        "one servo, instants in which time passes",
        _rules(),
        (*_ONE_SERVO[:3], *_ONE_SERVO[3::2]),
        waits_ns=_WAITS,
        within_ns=(TICK,),
        calm=False,
    ),
    Configuration(
        "one leg, commands for all of it and for a servo", _rules(repeats=1), _WHOLE_LEG, waits_ns=_WAITS, calm=False
    ),
    Configuration("one leg, its joints apart", _rules(), _EACH_JOINT, waits_ns=_WAITS, calm=False),
    Configuration(
        "one leg, frames a quarter of a period apart",
        _rules(timeout_ns=6 * TICK, period_ns=4 * TICK),
        (("servo", _each(START, 11)), ("servo", _each(SET, 11)), ("servo", _each(STOP, 11))),
        waits_ns=(*_WAITS, 4 * TICK),
        calm=False,
    ),
    Configuration(
        "a rate slot later than the watchdog",
        _rules(repeats=1, timeout_ns=2 * TICK, period_ns=3 * TICK),
        _WHOLE_LEG,
        waits_ns=_WAITS[1:],
        ends=True,
    ),
    Configuration("two legs", _rules(), _TWO_LEGS[1:], waits_ns=_WAITS[1:], calm=False),
    Configuration(
        "two legs, more runs of Stops at rest",
        _rules(rest_runs=1),
        (("servo", _each(START, 11)), ("servo", _each(STOP, 11)), ("servo", _each(STOP, 21))),
        ends=True,
    ),
    Configuration("two legs, repeated Stops", _rules(repeats=1), _TWO_LEGS[:4], waits_ns=_WAITS[1:], calm=False),
    Configuration(
        "two legs, rate slots later than the watchdog",
        _rules(timeout_ns=2 * TICK, period_ns=3 * TICK),
        (("legs", _each(START, 11, 21, 22)), ("servo", _each(START, 21)), ("servo", _each(STOP, 11))),
        calm=False,
    ),
    Configuration(
        "two legs, one silent leg stops both", _rules(whole_robot=True), _TWO_LEGS, waits_ns=_WAITS[1:], calm=False
    ),
    Configuration(
        "one servo, and an emergency stop that outlasts the gateway",
        _rules(timeout_ns=2 * TICK, estop_kept=True),
        (_ONE_SERVO[0], _ONE_SERVO[2]),
        waits_ns=(0, 3 * TICK),
        ends=True,
    ),
    Configuration(
        "two drivers and one lease",
        _rules(timeout_ns=2 * TICK, lease_ttl_ns=3 * TICK),
        (_ONE_SERVO[0], _ONE_SERVO[2]),
        drivers=("anna", "bert"),
    ),
    Configuration(
        "a lease that must be held, and whatever else may happen",
        _rules(timeout_ns=2 * TICK, lease_ttl_ns=3 * TICK, lease_required=True),
        (_ONE_SERVO[0], _ONE_SERVO[2]),
        drivers=("anna",),
        ends=True,
    ),
    Configuration(
        "two buttons, one of which must be alive",
        _rules(timeout_ns=2 * TICK, buttons_required=1, buttons_timeout_ns=3 * TICK),
        _ONE_SERVO[:1],
        waits_ns=(TICK, 4 * TICK),
        buttons=("kitchen", "door"),
    ),
    Configuration(
        "one button whose messages may be late",
        _rules(buttons_required=1, buttons_timeout_ns=3 * TICK),
        (_ONE_SERVO[0], _ONE_SERVO[2]),
        waits_ns=(TICK, 4 * TICK),
        buttons=("kitchen",),
        delays_ns=(0, TICK, 3 * TICK),
    ),
    Configuration(
        "a button that must be alive, and whatever else may happen",
        _rules(timeout_ns=2 * TICK, buttons_required=1, buttons_timeout_ns=2 * TICK),
        (_ONE_SERVO[0], _ONE_SERVO[2]),
        buttons=("kitchen",),
        ends=True,
    ),
    Configuration(
        "two legs, landing, and a button that must be alive",
        _rules(landing_ns=8 * TICK, landing_cdeg={11: HIGH}, buttons_required=1, buttons_timeout_ns=3 * TICK),
        (("legs", _each(START, 11, 21)), ("servo", _each(STOP, 21))),
        waits_ns=(TICK, 4 * TICK),
        buttons=("kitchen",),
    ),
    Configuration(
        "two legs that start and stop as one",
        _rules(starts_whole=True),
        (
            ("legs", _each(START, *_BOTH)),
            ("legs", _each(STOP, *_BOTH)),
            ("servo", _each(START, 11)),
            ("servo", _each(SET, 21)),
            ("servo", _each(STOP, 11)),
            ("leg", ((11, STOP), (12, START))),
        ),
        waits_ns=_WAITS[1:],
        unread=(_each(STOP, 11),),
        ends=True,
    ),
    Configuration(
        "two legs that start and stop as one, rate slots later than the watchdog, and landing",
        _rules(timeout_ns=2 * TICK, period_ns=3 * TICK, starts_whole=True, landing_ns=4 * TICK),
        (("legs", _each(START, *_BOTH)), ("servo", _each(SET, 21)), ("servo", _each(STOP, 11))),
        calm=False,
    ),
    Configuration(
        "two legs that start and stop as one, and a lease",
        _rules(timeout_ns=3 * TICK, period_ns=3 * TICK, starts_whole=True, lease_ttl_ns=3 * TICK),
        (("legs", _each(START, *_BOTH)), ("servo", _each(SET, 21)), ("leg", ((11, STOP), (12, START)))),
        drivers=("anna",),
    ),
    Configuration(
        "one servo, a battery and a body that may fall",
        _rules(min_battery_mv=5000, max_tilt_cdeg=30_00, tilt_ns=2 * TICK),
        (_ONE_SERVO[0], _ONE_SERVO[1], _ONE_SERVO[2]),
        bodies=((0, 7000), (0, 5050), (31_00, 4999), (None, 7000)),
        ends=True,
    ),
    Configuration(
        "two legs that start and stop as one, landing, and a body that may fall",
        _rules(starts_whole=True, landing_ns=6 * TICK, max_tilt_cdeg=30_00, tilt_ns=2 * TICK),
        (("legs", _each(START, *_BOTH)), ("servo", _each(STOP, 21))),
        bodies=((30_00, 0), (31_00, 0), (None, 0)),
    ),
    *(
        Configuration(
            f"one servo, and a board that {does}",
            _rules(timeout_ns=2 * TICK, period_ns=3 * TICK, power=True, feed_ns=4 * TICK),
            (_ONE_SERVO[0], _ONE_SERVO[1], _ONE_SERVO[2]),
            waits_ns=(0, TICK, 3 * TICK),
            boards=boards,
            calm=False,
        )
        for does, boards in (
            ("feeds it", (_FED, _SILENT, _BLOCKED)),
            ("does not confirm", (_FED, _ALIVE, _DOUBT)),
        )
    ),
    Configuration(
        "two legs, landing, and a board that feeds them",
        _rules(landing_ns=6 * TICK, landing_cdeg={11: HIGH}, power=True, feed_ns=3 * TICK),
        (("legs", _each(START, 11, 21)), ("servo", _each(START, 12)), ("servo", _each(STOP, 21))),
        boards=(_FED, replace(_FED, fed=frozenset({11})), _SILENT, PowerSeen(alive=True, lost=frozenset({11})), _DOUBT),
    ),
    Configuration(
        "two servos of a leg, and a board whose supply starts each",
        _rules(timeout_ns=3 * TICK, power=True, angles_first=True, feed_ns=4 * TICK),
        (
            ("leg", ((11, START), (12, START))),
            ("leg", ((11, STOP), (12, START))),
            ("servo", _each(SET, 12)),
            ("servo", _each(STOP, 11)),
        ),
        boards=(_FED, _SILENT, replace(_FED, fed=frozenset({11})), PowerSeen(alive=True, lost=frozenset({12}))),
    ),
    Configuration(
        "two servos of a leg, whose currents show whether they obey",
        _rules(timeout_ns=3 * TICK, power=True, feed_ns=4 * TICK),
        (("leg", ((11, START), (12, START))), ("servo", _each(STOP, 11))),
        boards=(
            *(_FED, replace(_FED, rests=False), replace(_FED, supplied=frozenset({11}))),
            *(PowerSeen(alive=True, drew=((each, "it draws"),)) for each in (11, 12)),
            PowerSeen(alive=True, lost=frozenset({12}), taken=frozenset({12})),
        ),
        calm=False,
    ),
    Configuration(
        "two legs, started one after the other",
        _rules(start_pause_ns=3 * TICK),
        (*_TWO_LEGS[:3], _TWO_LEGS[4]),
        waits_ns=_WAITS[1:],
        calm=False,
    ),
    Configuration(
        "one leg, a limited speed",
        _rules(max_speed_cdeg_s={11: 180_00 * NS_PER_S // (5 * TICK)}),
        (
            *(("servo", ((11, op),)) for op in (ServoOp(Op.START, 0), ServoOp(Op.SET, 180_00), STOP)),
            ("leg", ((11, ServoOp(Op.SET, 0)), (12, START))),
        ),
    ),
    Configuration(
        "two legs, a limited speed, started one after the other",
        _rules(timeout_ns=5 * TICK, start_pause_ns=4 * TICK, max_speed_cdeg_s={11: 180_00 * NS_PER_S // (8 * TICK)}),
        (
            ("servo", ((11, ServoOp(Op.START, 0)),)),
            ("legs", ((11, ServoOp(Op.SET, 180_00)), (21, START))),
            ("servo", _each(STOP, 22)),
        ),
    ),
    Configuration(
        "one servo, angles that are never sent, and a limited speed",
        _rules(avoid_cdeg=(40_00, 130_00), max_speed_cdeg_s={11: 180_00 * NS_PER_S // (8 * TICK)}),
        tuple(("servo", ((11, op),)) for op in (ServoOp(Op.START, 0), ServoOp(Op.SET, 180_00), ServoOp(Op.SET, 90_00))),
    ),
    Configuration(
        "one leg, angles that are never sent, and landing",
        _rules(landing_ns=8 * TICK, landing_cdeg={11: 180_00, 12: 90_00}, avoid_cdeg=(40_00, 130_00)),
        (
            *(("leg", ((11, ServoOp(op, angle)), (12, START))) for op, angle in ((Op.START, 0), (Op.SET, 150_00))),
            *_ONE_SERVO[2:4],
        ),
        waits_ns=(0, TICK, 3 * TICK),
    ),
    Configuration(
        "two legs, landing",
        _rules(landing_ns=8 * TICK, landing_cdeg={11: HIGH}),
        (*(("servo", _each(op, leg)) for leg in (11, 21) for op in (START, STOP)), ("legs", _each(SET, 11, 21))),
        ends=True,
    ),
    Configuration(
        "one leg, a servo of which is calibrated",
        _rules(timeout_ns=2 * TICK),
        (*_ONE_SERVO[0:3:2], ("leg", ((11, SET), (12, START)))),
        waits_ns=(TICK, 4 * TICK),
        calibration=_MIRRORED,
        changes=_RECALIBRATED[:2],
        calm=False,
    ),
    Configuration(
        "one servo, calibrated and limited in speed, and landing",
        _rules(
            landing_ns=4 * TICK,
            landing_cdeg={11: 90_00},
            max_speed_cdeg_s={11: 180_00 * NS_PER_S // (20 * TICK)},
            joint_limits_cdeg={11: (0, 100_00)},
        ),
        _ONE_SERVO[:3],
        waits_ns=(0, TICK, 3 * TICK),
        calibration=_MIRRORED,
        changes=_RECALIBRATED[1:],
    ),
    Configuration(
        "one servo, calibrated by its driver",
        _rules(timeout_ns=2 * TICK, lease_ttl_ns=3 * TICK),
        _ONE_SERVO[:1],
        drivers=("anna",),
        calibration=_MIRRORED,
        changes=_RECALIBRATED[:1],
    ),
    Configuration(
        "one servo, whose calibration cannot be read",
        _rules(),
        (*_ONE_SERVO[:3], ("leg", ((11, SET), (12, START)))),
        waits_ns=_WAITS[1:],
        calibration=_MIRRORED,
        fault="it is broken",
        changes=_RECALIBRATED[1:],
        ends=True,
    ),
    Configuration(
        "one leg, a limited speed and landing",
        _rules(landing_ns=5 * TICK, landing_cdeg={11: 180_00}, max_speed_cdeg_s={11: 180_00 * NS_PER_S // (5 * TICK)}),
        tuple(("servo", ((11, op),)) for op in (ServoOp(Op.START, 0), ServoOp(Op.SET, 90_00), STOP)),
        calm=False,
    ),
    Configuration(
        "one servo, two programs that take it from each other",
        _rules(takeover_cdeg_s=180_00 * NS_PER_S // (6 * TICK), takeover_known_ns=2 * TICK),
        (
            ("servo", ((11, ServoOp(Op.START, 0)),)),
            ("servo anna's", ((11, ServoOp(Op.SET, 180_00)),)),
            ("leg anna's", ((11, ServoOp(Op.START, 180_00)), (12, START))),
            ("servo", _each(STOP, 11)),
        ),
    ),
    Configuration(
        "one servo, started again soon, and calibrated meanwhile",
        _rules(timeout_ns=2 * TICK, takeover_cdeg_s=180_00 * NS_PER_S // (6 * TICK), takeover_known_ns=3 * TICK),
        (("servo", ((11, ServoOp(Op.START, 150_00)),)), ("servo", ((11, ServoOp(Op.START, 30_00)),)), _ONE_SERVO[2]),
        calibration=_MIRRORED,
        changes=_RECALIBRATED[:1],
    ),
    Configuration(
        "two servos of a leg, of which one waits for its supply while the other is taken over",
        _rules(
            timeout_ns=3 * TICK,
            period_ns=TICK,
            takeover_cdeg_s=180_00 * NS_PER_S // (2 * TICK),
            takeover_known_ns=2 * TICK,
            power=True,
            feed_ns=2 * TICK,
        ),
        (
            ("leg", ((11, ServoOp(Op.START, 0)), (12, ServoOp(Op.START, 0)))),
            ("servo", _each(STOP, 11)),
            ("servo anna's", ((11, ServoOp(Op.START, 90_00)),)),
        ),
        boards=(_FED,),
        waits_ns=(TICK,),
    ),
    Configuration(
        "one servo, taken over, and landing",
        _rules(
            takeover_cdeg_s=180_00 * NS_PER_S // (8 * TICK),
            takeover_known_ns=TICK,
            landing_ns=4 * TICK,
            landing_cdeg={11: 90_00},
        ),
        (
            ("servo", ((11, ServoOp(Op.START, 150_00)),)),
            ("servo anna's", ((11, ServoOp(Op.SET, 30_00)),)),
            _ONE_SERVO[2],
        ),
    ),
    Configuration(
        "one servo, started again soon, whatever else may happen",
        _rules(timeout_ns=2 * TICK, takeover_cdeg_s=180_00 * NS_PER_S // (6 * TICK), takeover_known_ns=2 * TICK),
        (("servo", ((11, ServoOp(Op.START, 0)),)), ("servo anna's", ((11, ServoOp(Op.START, 90_00)),)), _ONE_SERVO[2]),
        ends=True,
    ),
)
