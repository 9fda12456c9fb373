"""The supervisor under random commands, delays, faults and settings, with a controller that does what the frames say.

The oracle judges every step; the controller says which servos are really energised. Time may jump over any number of
deadlines, and any transfer may fail.
"""

from dataclasses import replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gateway.allowance import NS_PER_MS
from gateway.errors import SpiError
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import STOP, Op, ServoOp, decode, servo_ids_of
from gateway.model.framing import Framing
from gateway.robot.core import events
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.calibration import CalibrationCommand, ServoChange
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Kind, Mode
from tests.support.faulty_controller import FaultyController
from tests.support.history import demand, is_coalesced
from tests.support.model_check import pending
from tests.support.oracle import Oracle
from tests.support.transitions import TRANSITIONS

pytestmark = pytest.mark.full

MOVES = st.builds(ServoOp, st.sampled_from([Op.START, Op.START, Op.SET]), st.sampled_from([0, 45_00, 90_00, 180_00]))
OPS = st.one_of(MOVES, MOVES, st.just(STOP))
FEW_LEGS = st.sampled_from([1, 1, 2, 2, 3, 6])
"""Mostly the same ones, so that commands meet."""
BUS_FAULTS = [Kind.BUS_FAULT, Kind.CONTROLLER_SILENT, Kind.CONTROLLER_RESTARTED]
WAITS_NS = st.one_of(
    st.just(0),
    st.integers(1, 25 * NS_PER_MS),
    st.sampled_from([NS_PER_MS, 20 * NS_PER_MS, 40 * NS_PER_MS]),
    st.integers(0, 700 * NS_PER_MS),
)
RULES = st.builds(
    Rules,
    timeout_ns=st.sampled_from([20, 50, 250]).map(lambda ms: ms * NS_PER_MS),
    whole_robot=st.booleans(),
    repeats=st.integers(0, 3),
    repeat_interval_ns=st.sampled_from([1, 20, 300]).map(lambda ms: ms * NS_PER_MS),
    rest_ns=st.sampled_from([5, 30, 800]).map(lambda ms: ms * NS_PER_MS),
    rest_runs=st.integers(0, 3),
    rest_run_ns=st.sampled_from([5, 50, 1100]).map(lambda ms: ms * NS_PER_MS),
    period_ns=st.sampled_from([1, 20, 100, 1000]).map(lambda ms: ms * NS_PER_MS),
    unnumbered_reset_ns=st.sampled_from([1, 50, 2000]).map(lambda ms: ms * NS_PER_MS),
    start_pause_ns=st.sampled_from([0, 0, 15, 100]).map(lambda ms: ms * NS_PER_MS),
    joint_limits_cdeg=st.sampled_from([{}, {11: (10_00, 90_00), 62: (0, 0)}]),
    max_speed_cdeg_s=st.sampled_from([{}, {}, {11: 1, 12: 60_00, 21: 1000_00}]),
    takeover_cdeg_s=st.sampled_from([0, 1, 180_00, 1000_00]),
    landing_ns=st.sampled_from([0, 0, 50, 2000]).map(lambda ms: ms * NS_PER_MS),
    landing_cdeg=st.sampled_from([{}, {11: 0, 12: 180_00, 21: 30_00, 62: 0}]),
    lease_required=st.sampled_from([False, False, True]),
    lease_ttl_ns=st.sampled_from([30, 200, 1000]).map(lambda ms: ms * NS_PER_MS),
    min_battery_mv=st.sampled_from([0, 0, 7000]),
    max_tilt_cdeg=st.sampled_from([0, 0, 30_00]),
    tilt_ns=st.sampled_from([20, 200]).map(lambda ms: ms * NS_PER_MS),
    power=st.sampled_from([False, False, True]),
    feed_ns=st.sampled_from([30, 1800]).map(lambda ms: ms * NS_PER_MS),
)
WHOLE_OR_NOT = st.one_of(
    RULES, RULES, RULES.map(lambda rules: replace(rules, starts_whole=True, start_pause_ns=0, power=False))
)
CALIBRATIONS = st.sampled_from(
    [
        RobotCalibration(),
        RobotCalibration(),
        RobotCalibration(5, {11: ServoMapping(-10_00, inverted=True), 21: ServoMapping(max_cdeg=90_00)}, {11: 30_00}),
    ]
)
CHANGES = st.builds(
    CalibrationCommand.model_construct,
    servos=st.dictionaries(
        st.sampled_from(["11", "12", "21", "33"]),
        st.builds(
            ServoChange.model_construct,
            trim_deg=st.sampled_from([None, 0.0, 5.0, -90.0, 90.01]),
            inverted=st.sampled_from([None, True, False]),
            min_deg=st.sampled_from([None, 0.0, 0.0, 45.0]),
            max_deg=st.sampled_from([None, 180.0, 180.0, 90.0]),
        ),
        max_size=2,
    ),
    landing=st.dictionaries(st.sampled_from(["11", "62"]), st.sampled_from([None, 0.0, 50.0]), max_size=1),
)
DRIVERS = st.sampled_from(["anna", "ben"])
WHOSE = st.sampled_from(["now", "now", "now", "before", "nobody's"])
"""Of the lease as it is now, as it was before, or of none."""


def is_handover(effect: events.Effect) -> bool:
    return isinstance(effect, events.Announce) and effect.kind is Kind.SOURCE_CHANGED


def numbered(effect: events.Effect) -> object:
    """An effect with the numbers of requests in place of these."""
    match effect:
        case events.Transmit():
            numbers = [[each.number for each in named] for named in (effect.commands, effect.done)]
            return replace(effect, commands=(), done=()), numbers
        case events.Completed():
            return effect.request.number, is_coalesced(effect.request)
        case events.Rejected():
            return effect.request.number, effect.reason, effect.detail
    return effect


class SupervisorMachine(RuleBasedStateMachine):
    """One supervisor, its judge and its robot."""

    @initialize(
        rules=WHOLE_OR_NOT,
        now_ns=st.sampled_from([1, NS_PER_MS, 3_600_000_000_000]),
        calibration=CALIBRATIONS,
        fault=st.sampled_from([None] * 9 + ["it cannot be read"]),
    )
    def make(self, rules: Rules, now_ns: int, calibration: RobotCalibration, fault: str | None) -> None:
        self.now_ns = now_ns
        self.supervisor = Supervisor(rules)
        self.nameless = Supervisor(rules)
        """Takes the same, and hears of no source."""
        for supervisor in (self.supervisor, self.nameless):
            supervisor.calibrating.load(calibration, fault)
        self.oracle = Oracle(rules, calibration=calibration, fault=fault)
        self.controller = FaultyController(Framing.PLAIN, clock=lambda: self.now_ns)
        self.number = self.tokens = 0
        self.carries = "now"
        self.instant_ns: int | None = None
        if self.now_ns > 1:  # else it may be opened later, or not at all
            self.step(events.BusOpened())
            self.the_board_is_seen(alive=True, refused=(), lost=frozenset(), fed=frozenset(), doubt="", wait_ns=0)

    def step(self, event: events.Event, wait_ns: int = 0) -> None:
        """One step as the service takes it: write the frames, and tell of a transfer that failed. Or none, in a mode in
        which the event may not come."""
        mode = self.supervisor.mode
        if type(event) not in TRANSITIONS[mode]:
            return
        self.now_ns += wait_ns
        without = replace(event, source=None) if isinstance(event, events.Command) else event
        effects = self.supervisor.step(event, self.now_ns, self.instant_ns)
        nameless = self.nameless.step(without, self.now_ns, self.instant_ns)
        if not self.supervisor._rules.takeover_cdeg_s:
            demand(
                [numbered(effect) for effect in effects if not is_handover(effect)] == list(map(numbered, nameless)),
                "the source of commands changes only events, and the speed of a take-over",
            )
            demand(self.supervisor.due_ns == self.nameless.due_ns, "who commands changes no time")
        demand(self.supervisor.mode in TRANSITIONS[mode][type(event)], f"{mode} leads to {self.supervisor.mode}")
        self.oracle.judge(event, self.now_ns, effects, self.supervisor, self.instant_ns)
        fault: SpiError | None = None
        for effect in effects:
            if isinstance(effect, events.Transmit) and (fault is None or effect.frame.is_stop):
                data = effect.frame.to_bytes()
                assert decode(data) == effect.frame
                try:
                    self.controller.take(data)
                except SpiError as error:
                    fault = error
        if fault is not None:
            self.step(events.BusFailed(str(fault)))

    def command(self, channel: str, targets: tuple[tuple[int, ServoOp], ...], wait_ns: int) -> None:
        self.number += 1
        source = ("anna", "ben", None)[self.number % 3]
        self.step(
            events.Command(targets, key=channel, number=self.number, source=source, lease=self.token(self.carries)),
            wait_ns,
        )

    def token(self, whose: str) -> str | None:
        """None where there is no such lease."""
        lease = self.oracle.lease
        return {"now": lease.token, "before": lease.old_token, "nobody's": None}[whose]

    @rule(whose=WHOSE)
    def commands_carry(self, whose: str) -> None:
        """From now on."""
        self.carries = whose

    @rule(do=st.sampled_from(["acquire", "acquire", "ask", "take"]), name=DRIVERS, wait_ns=WAITS_NS)
    def wants_the_lease(self, do: events.LeaseDo, name: str, wait_ns: int) -> None:
        self.tokens += 1
        self.step(events.LeaseRequest(do, name, fresh_token=f"{self.tokens:032x}"), wait_ns)

    @rule(whose=WHOSE, to=st.one_of(st.none(), st.none(), DRIVERS), renew=st.booleans(), wait_ns=WAITS_NS)
    def keeps_or_releases_it(self, whose: str, to: str | None, renew: bool, wait_ns: int) -> None:
        do: events.LeaseDo = "renew" if renew else "release"
        self.step(events.LeaseRequest(do, token=self.token(whose), to=None if renew else to), wait_ns)

    @rule(servo_id=st.one_of(st.sampled_from([11, 12, 21]), st.sampled_from(SERVO_IDS)), op=OPS, wait_ns=WAITS_NS)
    def command_servo(self, servo_id: int, op: ServoOp, wait_ns: int) -> None:
        self.command(f"servo/{servo_id}", ((servo_id, op),), wait_ns)

    @rule(leg=FEW_LEGS, ops=st.one_of(st.tuples(OPS, OPS, OPS), OPS.map(lambda op: (op, op, op))), wait_ns=WAITS_NS)
    def command_leg(self, leg: int, ops: tuple[ServoOp, ServoOp, ServoOp], wait_ns: int) -> None:
        self.command(f"leg/{leg}", tuple(zip(servo_ids_of(leg), ops, strict=True)), wait_ns)

    @rule(legs=st.sets(FEW_LEGS, min_size=1), op=OPS, other=OPS, wait_ns=WAITS_NS)
    def command_legs(self, legs: set[int], op: ServoOp, other: ServoOp, wait_ns: int) -> None:
        ops = {leg: op if leg % 2 else other for leg in legs}
        targets = tuple((servo_id, ops[leg]) for leg in sorted(legs) for servo_id in servo_ids_of(leg))
        self.command("legs", targets, wait_ns)

    @rule(angle_cdeg=st.sampled_from([10_00, 80_00]), wait_ns=st.integers(0, 19 * NS_PER_MS))
    def start_everything(self, angle_cdeg: int, wait_ns: int) -> None:
        op = ServoOp(Op.START, angle_cdeg)
        self.command("legs", tuple((servo_id, op) for leg in LEGS for servo_id in servo_ids_of(leg)), wait_ns)

    @rule(
        change=CHANGES,
        older=st.sampled_from([None, None, 0, 1]),
        default=st.sampled_from([False] * 9 + [True]),
        wait_ns=WAITS_NS,
    )
    def calibrate(self, change: CalibrationCommand, older: int | None, default: bool, wait_ns: int) -> None:
        self.number += 1
        revision = None if older is None else self.supervisor.calibrating.in_force.revision - older
        lease = self.token(self.carries)
        self.step(
            events.Calibrate(number=self.number, change=change, revision=revision, accept_default=default, lease=lease),
            wait_ns,
        )

    @precondition(lambda self: self.oracle.calibration.on_its_way is not None)
    @rule(fault=st.sampled_from([None, None, "the disk is full"]), wait_ns=WAITS_NS)
    def the_disk_answers(self, fault: str | None, wait_ns: int) -> None:
        way = self.oracle.calibration.on_its_way
        self.step(events.CalibrationSaved(0 if way is None else way.number, fault), wait_ns)

    @rule(
        tilt_cdeg=st.sampled_from([None, 0, 30_00, 30_01, 180_00]),
        battery_mv=st.sampled_from([6900, 7000, 7140]),
        wait_ns=WAITS_NS,
    )
    def the_body_is_measured(self, tilt_cdeg: int | None, battery_mv: int, wait_ns: int) -> None:
        self.step(events.BodyMeasured(tilt_cdeg, battery_mv), wait_ns)

    @rule(
        alive=st.sampled_from([True, True, True, False]),
        refused=st.sampled_from([(), (), (), (11,), (12, 21)]),
        lost=st.sampled_from([frozenset(), frozenset(), frozenset({11}), frozenset({33, 62})]),
        fed=st.sampled_from([frozenset(SERVO_IDS), frozenset(SERVO_IDS), frozenset({11, 12, 13, 21}), frozenset()]),
        doubt=st.sampled_from(["", "", "", "it is not confirmed"]),
        wait_ns=WAITS_NS,
    )
    def the_board_is_seen(
        self,
        alive: bool,
        refused: tuple[int, ...],
        lost: frozenset[int],
        fed: frozenset[int],
        doubt: str,
        wait_ns: int,
    ) -> None:
        if self.supervisor._rules.power:
            why = tuple((servo_id, "overcurrent") for servo_id in refused)
            self.step(events.PowerSeen(alive, why, fed, lost, doubt), wait_ns)

    @rule(wait_ns=WAITS_NS)
    def time_passes(self, wait_ns: int) -> None:
        self.step(events.TimePassed(), wait_ns)

    @precondition(lambda self: self.supervisor.due_ns is not None)
    @rule(late_ns=st.sampled_from([0, 0, 1, NS_PER_MS]))
    def wake_up_when_due(self, late_ns: int) -> None:
        due_ns = self.supervisor.due_ns
        assert due_ns is not None
        self.step(events.TimePassed(), max(0, due_ns - self.now_ns) + late_ns)
        assert self.supervisor.due_ns is None or self.supervisor.due_ns > self.now_ns, "waking up makes progress"

    @rule(rarely=st.integers(0, 3), wait_ns=WAITS_NS)
    def emergency_stop(self, rarely: int, wait_ns: int) -> None:
        if rarely == 0:
            self.step(events.EmergencyStop("somebody"), wait_ns)

    @rule(newer=st.sampled_from([0, 0, 0, -1, 1, None]), wait_ns=WAITS_NS)
    def reset(self, newer: int | None, wait_ns: int) -> None:
        self.number += 1
        estop = None if newer is None else self.supervisor.latch.number + newer
        self.step(events.Reset(number=self.number, estop=estop, lease=self.token(self.carries)), wait_ns)

    @rule()
    def an_instant_begins(self) -> None:
        """What comes from now on was collected together, and takes time to deal with."""
        self.now_ns += 1
        self.instant_ns = self.now_ns

    @rule()
    def an_instant_ends(self) -> None:
        """What comes from now on came one by one."""
        self.now_ns += 1
        self.instant_ns = None

    @rule(rarely=st.integers(0, 3), at_work=st.booleans(), wait_ns=WAITS_NS)
    def stop_servos(self, rarely: int, at_work: bool, wait_ns: int) -> None:
        if rarely == 0 or not at_work:
            self.step(events.StoppedOutside(at_work), wait_ns)

    @rule(wait_ns=WAITS_NS)
    def bus_opens(self, wait_ns: int) -> None:
        if events.BusOpened in TRANSITIONS[self.supervisor.mode]:
            self.controller.fail_next(0)
        self.step(events.BusOpened(), wait_ns)

    @rule(rarely=st.integers(0, 5), kind=st.sampled_from(BUS_FAULTS), wait_ns=WAITS_NS)
    def bus_fails(self, rarely: int, kind: Kind, wait_ns: int) -> None:
        if rarely == 0:
            self.step(events.BusFailed("a test's fault", kind), wait_ns)

    @rule(count=st.sampled_from([0, 0, 0, 1, 3]))
    def transfers_will_fail(self, count: int) -> None:
        self.controller.fail_next(count)

    @rule(rarely=st.integers(0, 29), wait_ns=WAITS_NS)
    def shut_down(self, rarely: int, wait_ns: int) -> None:
        if rarely == 0:
            self.step(events.ShutDown(), wait_ns)

    @invariant()
    def the_robot_is_as_everybody_believes(self) -> None:
        assert not self.controller.corruptions
        if self.supervisor.mode in (Mode.IDLE, Mode.ACTIVE, Mode.ESTOPPED):
            running = {servo.servo_id for servo in self.supervisor.legs.servos.values() if servo.running}
            assert self.controller.energised == running == self.oracle.energised

    @invariant()
    def what_is_due_is_known(self) -> None:
        """A step looks only at the legs that it has changed; to look at all of them must come to the same."""
        legs = self.supervisor.legs
        kept = legs.due_ns, legs.repeat_ns, legs.at_rest
        legs.plan(self.now_ns)
        assert kept == (legs.due_ns, legs.repeat_ns, legs.at_rest)

    @invariant()
    def nothing_is_forgotten(self) -> None:
        assert pending(self.supervisor).keys() == self.oracle.pending.keys()


TestSupervisorMachine = SupervisorMachine.TestCase
TestSupervisorMachine.settings = settings(max_examples=150, stateful_step_count=60, deadline=None)
