"""The exhaustive check finds what is planted in the supervisor: each sentence of the oracle can be broken."""

import re
from dataclasses import replace

import pytest

from gateway.robot.core.calibration import Calibration
from gateway.robot.core.events import (
    Announce,
    ButtonAnswer,
    ButtonDo,
    ButtonRequest,
    Calibrate,
    Command,
    Completed,
    Keep,
    Kept,
    LeaseAnswer,
    LeaseRequest,
    Rejected,
    Reset,
    StoppedOutside,
    Transmit,
)
from gateway.robot.protocol.frames import STOP, OneServo, Op, ServoOp
from schemas.telemetry import Cause, Kind
from tests.fuzz import planted
from tests.fuzz.planted import Make, answering, ignoring, losing, made_of, making_up, taking, wanting, without_stops
from tests.support.history import Violation
from tests.support.model_check import check
from tests.support.small_robots import CONFIGURATIONS, TICK, Configuration

BY_NAME = {configuration.name: configuration for configuration in CONFIGURATIONS}
ONE_SERVO = BY_NAME["one servo, two channels"]
INSTANTS = BY_NAME["one servo, instants in which time passes"]
ONE_LEG = BY_NAME["one leg, commands for all of it and for a servo"]
QUARTER = BY_NAME["one leg, frames a quarter of a period apart"]
SLOW = BY_NAME["a rate slot later than the watchdog"]
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

START_11, SET_11 = (OneServo(11, ServoOp(op, 90_00)) for op in (Op.START, Op.SET))
STOP_11 = OneServo(11, STOP)

BUGS: dict[str, tuple[Configuration, Make, str]] = {
    "the watchdog stops one leg only": (BOTH_LEGS, ignoring(whole_robot=False), "legs not heard for the timeout"),
    "a watchdog's Stop is lost": (SLOW, losing(cause=Cause.WATCHDOG), "legs not heard for the timeout"),
    "no repeats": (ONE_SERVO, ignoring(repeats=0), "wakes up in time|a Stop is repeated in time"),
    "a repeat too many": (ONE_SERVO, ignoring(repeats=3), "a Stop to 11 that nobody owes|wakes up in time"),
    "a repeat of nothing": (SLOW, making_up(Transmit(STOP_11, Cause.REPEAT)), "a Stop to 11 that nobody owes"),
    "repeats after a start": (
        QUARTER,
        making_up(Transmit(STOP_11, Cause.REPEAT), where=lambda robot: robot.legs.servos[11].running),
        "11 runs: its Stops are not repeated any more",
    ),
    "more than Stops are repeated": (ONE_LEG, making_up(Transmit(SET_11, Cause.REPEAT)), "only Stops are repeated"),
    "twice the rate": (QUARTER, ignoring(period_ns=2 * TICK), "no frame without a rate slot"),
    "bursts": (QUARTER, made_of(slots=planted.Bursts), "no burst"),
    "starts without a pause": (STAGGERED, ignoring(start_pause_ns=0), "two legs are energised with a pause"),
    "oversleeping": (ONE_SERVO, planted.OversleepsTheWatchdog, "wakes up in time"),
    # Stops of all legs, and Stops on command
    "no Stops at the start": (ONE_LEG, losing(cause=Cause.STARTUP), "startup: a Stop to each leg and nothing else"),
    "no Stops at the end": (ONE_SERVO, losing(cause=Cause.SHUTDOWN), "shutdown: a Stop to each leg and nothing else"),
    "no Stops at an emergency": (ONE_SERVO, losing(cause=Cause.ESTOP), "estop: a Stop to each leg and nothing else"),
    "no Stops beside stop-servos": (
        ONE_LEG,
        without_stops(StoppedOutside),
        "repeat: a Stop to each leg and nothing else",
    ),
    "no Stops when the lease is taken": (
        DRIVERS,
        without_stops(LeaseRequest),
        "command: a Stop to each leg and nothing else",
    ),
    "a Stop on command is lost": (QUARTER, without_stops(Command), "the Stop for 11 is sent at once"),
    "a command's frame is lost": (ONE_SERVO, losing(cause=Cause.COMMAND), "an answer comes after the frames"),
    "Stops come last": (
        ONE_LEG,
        wanting(lambda _, __, effects: sorted(effects, key=planted.is_stop)),
        "all Stops come before anything else",
    ),
    # what nobody asked for
    "a start unasked": (ONE_LEG, making_up(Transmit(START_11, Cause.COMMAND)), "nobody asked for"),
    "a set unasked": (ONE_LEG, making_up(Transmit(SET_11, Cause.COMMAND)), "11 is set although it does not run"),
    "a landing unasked": (ONE_LEG, making_up(Transmit(SET_11, Cause.WATCHDOG)), "nothing moves unasked but a landing"),
    "a frame without a cause": (ONE_LEG, making_up(Transmit(SET_11, Cause.STARTUP)), "a frame without a cause"),
    "a frame to a bus at fault": (
        ONE_LEG,
        making_up(Transmit(STOP_11, Cause.REPEAT), where=lambda robot: not robot._bus_ok),
        "nothing is sent while the bus is at fault",
    ),
    # answers and reports
    "no answer": (ONE_SERVO, losing(coalesced=False), "every command is answered"),
    "an answer too many": (ONE_LEG, making_up(Completed(7)), "command 7 is answered exactly once"),
    "answers do not tell what was replaced": (
        ONE_SERVO,
        answering(Completed, coalesced=False),
        "replaced commands are answered as such",
    ),
    "frames name no command": (ONE_SERVO, answering(Transmit, numbers=()), "names set()"),
    "no rejection": (
        ONE_SERVO,
        wanting(lambda _, __, effects: [each for each in effects if not isinstance(each, Rejected)]),
        "rejected for servo_stopped, not for []",
    ),
    "an emergency stop that nobody is told of": (
        ONE_SERVO,
        losing(kind=Kind.ESTOP_ENGAGED),
        "an emergency stop is announced once",
    ),
    "stop-servos, and nobody is told": (
        ONE_LEG,
        losing(kind=Kind.STOPPED_OUTSIDE),
        "Stops from outside are announced once",
    ),
    # the emergency stop
    "a fault loses the latch": (ONE_LEG, planted.LatchLostInFault, "the mode is estopped"),
    "only the first is counted": (INSTANTS, planted.CountsOnlyTheFirst, "emergency stops were requested"),
    "no order within an instant": (INSTANTS, planted.InstantsOfTheirOwn, "rejected for servo_stopped"),
    "a reset without a number at once": (
        INSTANTS,
        ignoring(unnumbered_reset_ns=0),
        "a reset rejected for estopped, not for",
    ),
    "a reset of any number": (
        INSTANTS,
        taking(Reset, lambda robot, reset: reset if reset.estop is None else replace(reset, estop=robot.estops)),
        "a reset rejected for estopped, not for",
    ),
    # speed and landing
    "no limit of speed": (SPEED, ignoring(max_speed_cdeg_s={}), "11 goes no faster than its speed"),
    "a step too short": (
        SPEED,
        ignoring(max_speed_cdeg_s={11: SPEED.rules.max_speed_cdeg_s[11] // 2}),
        "11 goes as far as its speed allows",
    ),
    "the way goes on after a Stop": (SPEED, made_of(legs=planted.GoesOnAfterStop), "although it does not run"),
    "a landing through avoided angles": (AVOIDED_LANDING, ignoring(avoid_cdeg=None), "is sent where it must not go"),
    "across the gap at once": (
        AVOIDED,
        made_of(reach=planted.CrossesAtOnce),
        "11 goes across the gap no faster than its speed",
    ),
    "a landing that takes too long": (LANDING, ignoring(landing_ns=20 * TICK), "leaves its straight line|wakes up"),
    "a landing at once": (LANDING, made_of(legs=planted.LandsAtOnce), "leaves its straight line"),
    "no landing": (LANDING, ignoring(landing_ns=0), "legs not heard for the timeout"),
    # the lease
    "nobody is told that a lease ends": (
        DRIVERS,
        losing(kind=Kind.LEASE_EXPIRED),
        "a holder that falls silent loses the lease",
    ),
    "a longer lease": (DRIVERS, ignoring(lease_ttl_ns=9 * TICK), "wakes up in time"),
    "no lease required": (LEASE_REQUIRED, ignoring(lease_required=False), "rejected for no_lease"),
    "a takeover against the rules": (
        LEASE_REQUIRED,
        ignoring(lease_takeover=True),
        "take is answered with lease_denied|leads",
    ),
    "any token moves": (
        DRIVERS,
        taking(Command, lambda robot, command: replace(command, lease=robot.lease._token)),
        "rejected for not_holder",
    ),
    "whoever asks acquires it": (DRIVERS, answering(LeaseAnswer, reason=None), "ask is answered with no_lease"),
    "Stops need the lease": (DRIVERS, planted.StopsNeedPermission, "rejected for None"),
    "others' starts wait for the new holder": (
        SLOW_DRIVER,
        wanting(
            lambda _, event, effects: [
                each for each in effects if not (isinstance(event, LeaseRequest) and isinstance(each, Rejected))
            ]
        ),
        "what waited of others moves under no new holder",
    ),
    "the token is not given": (DRIVERS, answering(LeaseAnswer, token=None), "who acquires it hears the token"),
    "the holder is not named": (DRIVERS, answering(LeaseAnswer, holder="nobody"), "the answer names the holder"),
    "a change of the lease is not told": (
        DRIVERS,
        losing(kind=Kind.LEASE_ACQUIRED),
        "a change of the lease is told once",
    ),
    "not waking up for the lease": (DRIVERS, planted.WakesUpForLegsOnly, "wakes up in time"),
    "not waking up for the lease in a fault": (
        LEASE_REQUIRED,
        planted.WakesUpForLegsOnly,
        "no time but the lease's|wakes up in time",
    ),
    # buttons
    "nobody is told of a silent button": (
        BUTTONS,
        losing(kind=Kind.BUTTON_SILENT),
        "a button that is not heard is silent",
    ),
    "a silent button counts": (BUTTONS, ignoring(buttons_timeout_ns=9 * TICK), "wakes up in time"),
    "too few buttons are enough": (BUTTONS, ignoring(buttons_required=0), "rejected for no_button"),
    "a late check-in counts from its arrival": (
        LATE_BUTTON,
        taking(ButtonRequest, lambda _, request: replace(request, sent_ms=None)),
        "not heard is silent|answered with stale|wakes up",
    ),
    "leaving is not noticed": (
        BUTTONS,
        taking(
            ButtonRequest,
            lambda _, asked: replace(asked, do=ButtonDo.ALIVE, count=99) if asked.do is ButtonDo.LEAVE else asked,
        ),
        "leave is answered|leave: .* is told|are alive, not",
    ),
    "any check-in is granted": (BUTTONS, answering(ButtonAnswer, reason=None), "alive is answered with"),
    "the buttons alive are miscounted": (BUTTONS, answering(ButtonAnswer, alive=7), "are alive, not 7"),
    "a registration without a token": (BUTTONS, answering(ButtonAnswer, token=None), "who registers gets the token"),
    "what runs goes on unwatched": (ANY_BUTTON, losing(cause=Cause.WATCHDOG), "those that too few buttons watch"),
    "no landing when unwatched": (BUTTON_LANDING, ignoring(landing_ns=0), "rejected for landing|are stopped"),
    "Stops need a button": (ANY_BUTTON, planted.StopsNeedPermission, "rejected for None"),
    "not waking up for the buttons": (ANY_BUTTON, planted.WakesUpForLegsOnly, "wakes up in time|no time but"),
    # the calibration
    "users' angles on the wire": (
        CALIBRATED,
        made_of(reach=planted.FramesAsCommanded),
        "11: the newest target is sent",
    ),
    "any angle": (CALIBRATED_LANDING, made_of(reach=planted.AnyAngle), "rejected for joint_limit"),
    "another landing pose": (
        CALIBRATED_LANDING,
        made_of(reach=planted.LandsWhereTheSettingsSay),
        "straight line|follows its line",
    ),
    "what runs is calibrated": (
        CALIBRATED,
        made_of(calibrating=planted.ChangesWhatRuns),
        "what is rejected is not kept",
    ),
    "any revision is changed": (
        CALIBRATED,
        taking(Calibrate, lambda _, event: replace(event, revision=None)),
        "what is rejected is not kept",
    ),
    "calibrated in any mode": (CALIBRATED, planted.AnybodyCalibrates, "what is rejected is not kept"),
    "calibrated by anybody": (CALIBRATING_DRIVER, planted.AnybodyCalibrates, "what is rejected is not kept"),
    "another change is kept": (
        CALIBRATED,
        answering(Keep, calibration=Calibration(9)),
        "the change is kept as it was asked for",
    ),
    "kept without a change": (
        CALIBRATED,
        making_up(Keep(7, Calibration(2))),
        "only a change of the calibration is kept",
    ),
    "in force before it is kept": (
        CALIBRATED,
        making_up(Announce(Kind.CALIBRATED, "")),
        "a calibration is in force once it is kept",
    ),
    "nobody is told of a calibration": (CALIBRATED, losing(kind=Kind.CALIBRATED), "a new calibration is told"),
    "what the disk did not take is in force": (
        CALIBRATED,
        taking(Kept, lambda _, kept: replace(kept, fault=None)),
        "a new calibration is told|rejected for",
    ),
    "starts by a calibration that cannot be read": (
        UNREAD,
        made_of(calibrating=planted.StartsUntrusted),
        "rejected for servo_stopped",
    ),
}


@pytest.mark.parametrize("bug", BUGS)
def test_it_finds_a_planted_bug(bug: str) -> None:
    configuration, make, promise = BUGS[bug]
    with pytest.raises(Violation, match=re.sub(r"[\[()]", r"\\\g<0>", promise)):
        check(configuration, make)


def test_a_supervisor_without_a_bug_keeps_every_promise() -> None:
    """Else the bugs planted above might be found for the planting alone."""
    check(SLOW, made_of())
    small = replace(UNREAD, commands=UNREAD.commands[:1], waits_ns=UNREAD.waits_ns[:1])
    check(small, wanting(lambda _, __, effects: effects))
