"""The exhaustive check finds what is planted in the supervisor: each sentence of the oracle can be broken."""

import re
from dataclasses import replace

import pytest

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import STOP, OneServo, Op, ServoOp
from gateway.robot.core.events import (
    Announce,
    BodyMeasured,
    ButtonDo,
    ButtonRequest,
    Calibrate,
    CalibrationSaved,
    Command,
    Completed,
    Effect,
    Event,
    LeaseRequest,
    PowerSeen,
    Rejected,
    RequestAnswer,
    Reset,
    SaveCalibration,
    StoppedOutside,
    Transmit,
)
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Cause, Kind, Reason
from tests.fuzz import planted
from tests.fuzz.planted import (
    Make,
    answering,
    ignoring,
    losing,
    made_of,
    making_up,
    showing,
    taking,
    wanting,
    without_stops,
)
from tests.support.history import Violation, is_coalesced, spelled_out
from tests.support.model_check import check
from tests.support.small_robots import CONFIGURATIONS, TICK, Configuration

BY_NAME = {configuration.name: configuration for configuration in CONFIGURATIONS}
ONE_SERVO = BY_NAME["one servo, two channels"]
INSTANTS = BY_NAME["one servo, instants in which time passes"]
ONE_LEG = BY_NAME["one leg, commands for all of it and for a servo"]
QUARTER = BY_NAME["one leg, frames a quarter of a period apart"]
SLOW = BY_NAME["a rate slot later than the watchdog"]
TWO_LEGS = BY_NAME["two legs"]
BOTH_LEGS = BY_NAME["two legs, one silent leg stops both"]
STAGGERED = BY_NAME["two legs, started one after the other"]
SPEED = BY_NAME["one leg, a limited speed"]
LANDING = BY_NAME["two legs, landing"]
AVOIDED = BY_NAME["one servo, angles that are never sent, and a limited speed"]
AVOIDED_LANDING = BY_NAME["one leg, angles that are never sent, and landing"]
DRIVERS = BY_NAME["two drivers and one lease"]
SLOW_DRIVER = replace(DRIVERS, rules=replace(DRIVERS.rules, period_ns=8 * TICK), drivers=("anna",))
LEASE_REQUIRED = BY_NAME["a lease that must be held and is never taken, and whatever else may happen"]
BUTTONS = BY_NAME["two buttons, one of which must be alive"]
LATE_BUTTON = BY_NAME["one button whose messages may be late"]
ANY_BUTTON = BY_NAME["a button that must be alive, and whatever else may happen"]
BUTTON_LANDING = BY_NAME["two legs, landing, and a button that must be alive"]
CALIBRATED = BY_NAME["one leg, a servo of which is calibrated"]
CALIBRATED_LANDING = BY_NAME["one servo, calibrated and limited in speed, and landing"]
CALIBRATING_DRIVER = BY_NAME["one servo, calibrated by its driver"]
UNREAD = BY_NAME["one servo, whose calibration cannot be read"]
BODY = BY_NAME["one servo, a battery and a body that may fall"]
POWER = BY_NAME["one servo, and a board that feeds it"]
POWER_LANDING = BY_NAME["two legs, landing, and a board that feeds them"]
POWER_WHOLE = BY_NAME["two legs that start and stop as one, and a board that feeds them"]
WHOLE = BY_NAME["two legs that start and stop as one"]
WHOLE_SLOW = BY_NAME["two legs that start and stop as one, rate slots later than the watchdog, and landing"]
WHOLE_LANDING = BY_NAME["two legs that start and stop as one, landing, and a body that may fall"]


def answered_only(_robot: Supervisor, _event: Event, effects: list[Effect]) -> list[Effect]:
    """Commands are answered, and their frames lost."""
    return [each for each in spelled_out(effects) if not (isinstance(each, Transmit) and each.cause is Cause.COMMAND)]


def uncoalesced(_robot: Supervisor, _event: Event, effects: list[Effect]) -> list[Effect]:
    """No command is answered as replaced."""
    for effect in effects:
        if isinstance(effect, Completed | Transmit):
            for each in filter(is_coalesced, effect.done):
                assert isinstance(each, Command)
                each.coalesced = False
    return effects


START_11, SET_11 = (OneServo(11, ServoOp(op, 90_00)) for op in (Op.START, Op.SET))
STOP_11 = OneServo(11, STOP)

BROKEN: list[tuple[str, Configuration, Make]] = [
    ("legs not heard for the timeout", BOTH_LEGS, ignoring(whole_robot=False)),
    ("legs not heard for the timeout", SLOW, losing(cause=Cause.WATCHDOG)),
    ("wakes up in time|a Stop is repeated in time", ONE_SERVO, ignoring(repeats=0)),
    ("a Stop to 11 that nobody owes|wakes up in time", ONE_SERVO, ignoring(repeats=3)),
    ("a Stop to 11 that nobody owes", SLOW, making_up(Transmit(STOP_11, Cause.REPEAT))),
    (
        "11 runs: its Stops are not repeated any more",
        QUARTER,
        making_up(Transmit(STOP_11, Cause.REPEAT), where=lambda robot: robot.legs.servos[11].running),
    ),
    ("only Stops are repeated", ONE_LEG, making_up(Transmit(SET_11, Cause.REPEAT))),
    ("legs at rest get a Stop each", TWO_LEGS, losing(joins=True)),
    ("wakes up in time", TWO_LEGS, ignoring(rest_ns=1000 * TICK)),
    ("no frame without a rate slot", QUARTER, ignoring(period_ns=2 * TICK)),
    ("no burst", QUARTER, made_of(slots=planted.Bursts)),
    ("two legs are energised with a pause", STAGGERED, ignoring(start_pause_ns=0)),
    ("wakes up in time", ONE_SERVO, planted.OversleepsTheWatchdog),
    # Stops of all legs, and Stops on command
    ("startup: a Stop to each leg and nothing else", ONE_LEG, losing(cause=Cause.STARTUP)),
    ("shutdown: a Stop to each leg and nothing else", ONE_SERVO, losing(cause=Cause.SHUTDOWN)),
    ("estop: a Stop to each leg and nothing else", ONE_SERVO, losing(cause=Cause.ESTOP)),
    ("repeat: a Stop to each leg and nothing else", ONE_LEG, without_stops(StoppedOutside)),
    ("command: a Stop to each leg and nothing else", DRIVERS, without_stops(LeaseRequest)),
    ("the Stop for 11 is sent at once", QUARTER, without_stops(Command)),
    (
        "an answer comes after the frames",
        ONE_SERVO,
        wanting(answered_only),
    ),
    (
        "all Stops come before anything else",
        ONE_LEG,
        wanting(lambda _, __, effects: sorted(effects, key=planted.is_stop)),
    ),
    # what nobody asked for
    ("nobody asked for", ONE_LEG, making_up(Transmit(START_11, Cause.COMMAND))),
    ("11 is set although it does not run", ONE_LEG, making_up(Transmit(SET_11, Cause.COMMAND))),
    ("nothing moves unasked but a landing", ONE_LEG, making_up(Transmit(SET_11, Cause.WATCHDOG))),
    ("a frame without a cause", ONE_LEG, making_up(Transmit(SET_11, Cause.STARTUP))),
    (
        "nothing is sent while the bus is at fault",
        ONE_LEG,
        making_up(Transmit(STOP_11, Cause.REPEAT), where=lambda robot: not robot._bus_ok),
    ),
    # answers and reports
    ("every command is answered", ONE_SERVO, answering(Transmit, done=())),
    ("command 7 is answered exactly once", ONE_LEG, making_up(Completed(Command(number=7)))),
    ("replaced commands are answered as such", ONE_SERVO, wanting(uncoalesced)),
    ("names set()", ONE_SERVO, answering(Transmit, commands=(), done=())),
    (
        "rejected for servo_stopped, not for []",
        ONE_SERVO,
        wanting(lambda _, __, effects: [each for each in effects if not isinstance(each, Rejected)]),
    ),
    ("an emergency stop is announced once", ONE_SERVO, losing(kind=Kind.ESTOP_ENGAGED)),
    ("Stops from outside are announced once", ONE_LEG, losing(kind=Kind.STOPPED_OUTSIDE)),
    # the emergency stop
    ("the mode is estopped", ONE_LEG, planted.LatchLostInFault),
    ("emergency stops were requested", INSTANTS, planted.CountsOnlyTheFirst),
    ("rejected for servo_stopped", INSTANTS, planted.InstantsOfTheirOwn),
    ("a reset rejected for estopped, not for", INSTANTS, ignoring(unnumbered_reset_ns=0)),
    (
        "a reset rejected for estopped, not for",
        INSTANTS,
        taking(Reset, lambda robot, reset: reset if reset.estop is None else replace(reset, estop=robot.estops)),
    ),
    # speed and landing
    ("11 goes no faster than its speed", SPEED, ignoring(max_speed_cdeg_s={})),
    (
        "11 goes as far as its speed allows",
        SPEED,
        ignoring(max_speed_cdeg_s={11: SPEED.rules.max_speed_cdeg_s[11] // 2}),
    ),
    ("although it does not run", SPEED, made_of(legs=planted.GoesOnAfterStop)),
    ("is sent where it must not go", AVOIDED_LANDING, ignoring(avoid_cdeg=None)),
    ("11 goes across the gap no faster than its speed", AVOIDED, made_of(reach=planted.CrossesAtOnce)),
    ("leaves its straight line|wakes up", LANDING, ignoring(landing_ns=20 * TICK)),
    ("leaves its straight line", LANDING, made_of(legs=planted.LandsAtOnce)),
    # the lease
    ("a holder that falls silent loses the lease", DRIVERS, losing(kind=Kind.LEASE_EXPIRED)),
    ("wakes up in time", DRIVERS, ignoring(lease_ttl_ns=9 * TICK)),
    ("rejected for no_lease", LEASE_REQUIRED, ignoring(lease_required=False)),
    ("take is answered with lease_denied", LEASE_REQUIRED, ignoring(lease_takeover=True)),
    (
        "rejected for not_holder",
        DRIVERS,
        taking(Command, lambda robot, command: replace(command, lease=robot.lease._token)),
    ),
    ("ask is answered with no_lease", DRIVERS, answering(RequestAnswer, reason=None)),
    ("rejected for None", DRIVERS, planted.StopsNeedPermission),
    (
        "what waited of others moves under no new holder",
        SLOW_DRIVER,
        wanting(
            lambda _, event, effects: [
                each for each in effects if not (isinstance(event, LeaseRequest) and isinstance(each, Rejected))
            ]
        ),
    ),
    ("who acquires it hears the token", DRIVERS, answering(RequestAnswer, token=None)),
    ("holds the lease, not nobody", DRIVERS, showing("lease", holder="nobody")),
    ("a change of the lease is told once", DRIVERS, losing(kind=Kind.LEASE_ACQUIRED)),
    ("no time but the lease's|wakes up in time", LEASE_REQUIRED, planted.WakesUpForLegsOnly),
    # buttons
    ("a button that is not heard is silent", BUTTONS, losing(kind=Kind.BUTTON_SILENT)),
    ("wakes up in time", BUTTONS, ignoring(buttons_timeout_ns=9 * TICK)),
    ("rejected for no_button", BUTTONS, ignoring(buttons_required=0)),
    (
        "not heard is silent|answered with stale|wakes up",
        LATE_BUTTON,
        taking(ButtonRequest, lambda _, request: replace(request, sent_ms=None)),
    ),
    (
        "leave is answered|leave: .* is told",
        BUTTONS,
        taking(
            ButtonRequest,
            lambda _, asked: replace(asked, do=ButtonDo.ALIVE, count=99) if asked.do is ButtonDo.LEAVE else asked,
        ),
    ),
    ("alive is answered with", BUTTONS, answering(RequestAnswer, reason=None)),
    ("are alive, not 7", BUTTONS, showing("buttons", alive=7)),
    ("who registers gets the token", BUTTONS, answering(RequestAnswer, token=None)),
    ("those that too few buttons watch", ANY_BUTTON, losing(cause=Cause.WATCHDOG)),
    ("rejected for landing|are stopped", BUTTON_LANDING, ignoring(landing_ns=0)),
    ("rejected for None", ANY_BUTTON, planted.StopsNeedPermission),
    ("wakes up in time|no time but", ANY_BUTTON, planted.WakesUpForLegsOnly),
    # the calibration
    ("11: the newest target is sent", CALIBRATED, made_of(reach=planted.FramesAsCommanded)),
    ("rejected for joint_limit", CALIBRATED_LANDING, made_of(reach=planted.AnyAngle)),
    ("straight line|follows its line", CALIBRATED_LANDING, made_of(reach=planted.LandsWhereTheSettingsSay)),
    ("what is rejected is not kept", CALIBRATED, made_of(calibrating=planted.ChangesWhatRuns)),
    ("what is rejected is not kept", CALIBRATED, taking(Calibrate, lambda _, event: replace(event, revision=None))),
    ("what is rejected is not kept", CALIBRATED, planted.AnybodyCalibrates),
    ("what is rejected is not kept", CALIBRATING_DRIVER, planted.AnybodyCalibrates),
    ("the change is kept as it was asked for", CALIBRATED, answering(SaveCalibration, calibration=RobotCalibration(9))),
    ("only a change of the calibration is kept", CALIBRATED, making_up(SaveCalibration(7, RobotCalibration(2)))),
    ("a calibration is in force once it is kept", CALIBRATED, making_up(Announce(Kind.CALIBRATED, ""))),
    ("a new calibration is told", CALIBRATED, losing(kind=Kind.CALIBRATED)),
    (
        "a new calibration is told|rejected for",
        CALIBRATED,
        taking(CalibrationSaved, lambda _, kept: replace(kept, fault=None)),
    ),
    ("rejected for servo_stopped", UNREAD, made_of(calibrating=planted.StartsUntrusted)),
    ("a battery is announced once when it becomes low", BODY, losing(kind=Kind.BATTERY_LOW)),
    ("a fall is announced once", BODY, losing(kind=Kind.FALLEN)),
    ("a fall is announced once", BODY, ignoring(tilt_ns=TICK)),
    ("a fall is announced once", BODY, taking(BodyMeasured, lambda _, each: replace(each, tilt_cdeg=None))),
    ("legs not heard for the timeout", BODY, without_stops(BodyMeasured)),
    ("rejected for battery_low", BODY, planted.FitForAnything),
    ("rejected for fallen", WHOLE_LANDING, planted.FitForAnything),
    ("that the bus is back is announced as its fault was", BODY, losing(kind=Kind.CONTROLLER_RETURNED)),
    ("that the bus is back is announced as its fault was", ONE_SERVO, losing(kind=Kind.BUS_RECOVERED)),
    ("a fault of the bus is announced once", BODY, losing(kind=Kind.CONTROLLER_SILENT)),
    # the power board
    ("rejected for no_power", POWER, ignoring(power=False)),
    ("rejected for no_power", POWER, planted.FeedsInItsSleep),
    ("rejected for no_power", POWER, taking(PowerSeen, lambda _, seen: replace(seen, alive=True))),
    ("rejected for no_power|are stopped", POWER, taking(PowerSeen, lambda _, seen: replace(seen, refused=()))),
    ("watchdog: a Stop to each leg", POWER, without_stops(PowerSeen)),
    ("watchdog: a Stop to each leg", POWER, taking(PowerSeen, lambda _, seen: replace(seen, doubt=""))),
    ("watchdog: a Stop to each leg", POWER, planted.DoubtsBesideTheWatchdog),
    ("are stopped: [1]", POWER_LANDING, taking(PowerSeen, lambda _, seen: replace(seen, lost=frozenset()))),
    ("rejected for landing|are stopped", POWER_LANDING, ignoring(landing_ns=0)),
    ("rejected for landing|wakes up", POWER_LANDING, planted.RunsOnWithoutBoard),
    ("are stopped: [1, 2]", POWER_WHOLE, planted.LosesOneLeg),
    ("are stopped: [1, 2]|are stopped: [1]", POWER_WHOLE, planted.StartsWhatWaitsForABlock),
    ("rejected for whole_robot", WHOLE, made_of(legs=planted.StartsByLeg)),
    ("the whole robot runs, or nothing of it", WHOLE_SLOW, made_of(legs=planted.StartsInItsOwnSlot)),
    ("is sent at once", WHOLE, made_of(legs=planted.StopsByServo)),
    ("rejected for whole_robot", WHOLE, answering(Rejected, reason=Reason.STALE)),
    ("legs not heard for the timeout", WHOLE, planted.SilenceStopsOneLeg),
]
"""The sentence of the oracle, the robot on which it is broken, and by what."""


@pytest.mark.parametrize(
    ("promise", "configuration", "make"), BROKEN, ids=[f"{promise}, {where.name}" for promise, where, _ in BROKEN]
)
def test_a_promise_that_is_broken_is_a_violation(promise: str, configuration: Configuration, make: Make) -> None:
    with pytest.raises(Violation, match=re.sub(r"[\[()]", r"\\\g<0>", promise)):
        check(configuration, make)


def test_a_supervisor_without_a_bug_keeps_every_promise() -> None:
    """Else the bugs planted above might be found for the planting alone."""
    small = replace(UNREAD, commands=UNREAD.commands[:1], waits_ns=UNREAD.waits_ns[:1])
    for make in (made_of(), wanting(lambda _, __, effects: effects)):
        check(small, make)
