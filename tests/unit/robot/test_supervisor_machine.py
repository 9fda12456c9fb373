"""The supervisor under random commands, delays, faults and settings, with a controller that does what the frames say.

The oracle judges every step; the controller, and a plug-in in its place, say which servos are really energised. Time
may jump over any number of deadlines, and any transfer may fail. What the journal keeps of all this decides the same.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from pydantic_core import from_json, to_json

from gateway.errors import SpiError
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import STOP, Framing, Op, ServoOp, decode, servo_ids_of
from gateway.rate_limit import NS_PER_MS
from gateway.robot.blackbox import journal
from gateway.robot.core import events
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.spi import Transfer
from gateway.robot.spi.plugin import PluginDevice
from gateway.wire import ServoWire
from schemas.calibration import CalibrationCommand, ServoChange
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Kind, Mode
from tests.support.controllers import FaultyController
from tests.support.history import announced, demand, numbered
from tests.support.model_check import State, both_ways, candidates, pending
from tests.support.oracle import Oracle
from tests.support.small_robots import Configuration, Targets
from tests.support.transitions import TRANSITIONS

pytestmark = pytest.mark.full

MOVES = st.builds(ServoOp, st.sampled_from([Op.START, Op.START, Op.SET]), st.sampled_from([0, 45_00, 90_00, 180_00]))
OPS = st.one_of(MOVES, MOVES, st.just(STOP))
WHO = st.sampled_from(["", " anna's", " ben's"])
FEW_LEGS = st.sampled_from([1, 1, 2, 2, 3, 6])
"""Mostly the same ones, so that commands meet."""


def targets_of(legs: Iterable[int], op: ServoOp, other: ServoOp) -> Targets:
    return tuple((servo_id, op if leg % 2 else other) for leg in sorted(legs) for servo_id in servo_ids_of(leg))


SERVO = st.tuples(st.one_of(st.sampled_from([11, 12, 21]), st.sampled_from(SERVO_IDS)), OPS)
COMMANDS = st.one_of(
    st.builds(lambda who, target: (f"servo/{target[0]}{who}", (target,)), WHO, SERVO),
    st.builds(
        lambda who, leg, ops: (f"leg/{leg}{who}", tuple(zip(servo_ids_of(leg), ops, strict=True))),
        WHO, FEW_LEGS, st.one_of(st.tuples(OPS, OPS, OPS), OPS.map(lambda op: (op, op, op))),
    ),
    st.builds(
        lambda who, legs, op, other: (f"legs{who}", targets_of(legs, op, other)),
        WHO, st.sets(FEW_LEGS, min_size=1), OPS, OPS,
    ),
    st.builds(
        lambda who, cdeg: (f"legs{who}", targets_of(LEGS, *[ServoOp(Op.START, cdeg)] * 2)),
        WHO, st.sampled_from([10_00, 80_00]),
    ),
)  # fmt: skip
BODIES = st.tuples(st.sampled_from([None, 0, 30_00, 30_01, 180_00]), st.sampled_from([6900, 7000, 7140]))
BOARDS = st.builds(
    events.PowerSeen,
    st.sampled_from([True, True, True, False]),
    st.sampled_from([(), (), (), ((11, "overcurrent"),), ((12, "overcurrent"), (21, "overcurrent"))]),
    st.sampled_from([frozenset(SERVO_IDS), frozenset(SERVO_IDS), frozenset({11, 12, 13, 21}), frozenset[int]()]),
    st.sampled_from([frozenset[int](), frozenset[int](), frozenset({11}), frozenset({33, 62})]),
    st.sampled_from(["", "", "", "it is not confirmed"]),
    st.sampled_from([frozenset[int](), frozenset[int](), frozenset({11}), frozenset({33, 62})]),
    st.sampled_from([frozenset[int](), frozenset(SERVO_IDS), frozenset({11})]),
    st.sampled_from([(), (), (), (), ((11, "it draws"),), ((12, "it draws"), (33, "it draws"))]),
    st.booleans(),
)
WAITS_NS = st.one_of(
    st.just(0),
    st.integers(1, 25 * NS_PER_MS),
    st.sampled_from([NS_PER_MS, 20 * NS_PER_MS, 40 * NS_PER_MS]),
    st.integers(0, 700 * NS_PER_MS),
)
OFTEN: dict[type[events.Event], int] = {events.Command: 12, events.BusOpened: 8, events.TimePassed: 3, events.Reset: 3}
"""Of what can happen, how many times as often as another kind."""
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
    start_wait_ns=st.sampled_from([0, 0, 15]).map(lambda ms: ms * NS_PER_MS),
    start_pause_ns=st.sampled_from([0, 0, 15, 100]).map(lambda ms: ms * NS_PER_MS),
    joint_limits_cdeg=st.sampled_from([{}, {11: (10_00, 90_00), 62: (0, 0)}]),
    avoid_cdeg=st.sampled_from([None, None, (1_00, 4_00), (40_00, 80_00)]),
    max_speed_cdeg_s=st.sampled_from([{}, {}, {11: 1, 12: 60_00, 21: 1000_00}]),
    takeover_cdeg_s=st.sampled_from([0, 1, 180_00, 1000_00]),
    takeover_known_ns=st.sampled_from([50, 2000]).map(lambda ms: ms * NS_PER_MS),
    landing_ns=st.sampled_from([0, 0, 50, 2000]).map(lambda ms: ms * NS_PER_MS),
    landing_cdeg=st.sampled_from([{}, {11: 0, 12: 180_00, 21: 30_00, 62: 0}]),
    lease_required=st.sampled_from([False, False, True]),
    lease_ttl_ns=st.sampled_from([30, 200, 1000]).map(lambda ms: ms * NS_PER_MS),
    buttons_required=st.sampled_from([0, 0, 0, 1]),
    buttons_timeout_ns=st.sampled_from([200, 1000]).map(lambda ms: ms * NS_PER_MS),
    estop_kept=st.sampled_from([False, False, True]),
    min_battery_mv=st.sampled_from([0, 0, 7000]),
    max_tilt_cdeg=st.sampled_from([0, 0, 30_00]),
    tilt_ns=st.sampled_from([20, 200]).map(lambda ms: ms * NS_PER_MS),
    power=st.booleans(),
    angles_first=st.booleans(),
    feed_ns=st.sampled_from([30, 1800]).map(lambda ms: ms * NS_PER_MS),
)
RULES = RULES.map(lambda rules: replace(rules, angles_first=rules.angles_first and rules.power))


def with_every_motion(rules: Rules) -> Rules:
    """Return rules that meet often: all that change how servos move, and none that keeps the robot from moving."""
    landing_cdeg = {11: 0, 12: 180_00, 21: 30_00, 62: 0}
    moves = replace(rules, takeover_cdeg_s=180_00, landing_ns=2000 * NS_PER_MS, landing_cdeg=landing_cdeg)
    return replace(moves, lease_required=False, min_battery_mv=0)


WHOLE_OR_NOT = st.one_of(
    RULES,
    RULES.map(with_every_motion),
    RULES.map(lambda rules: replace(rules, starts_whole=True, start_pause_ns=0, power=False, angles_first=False)),
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


class Plugged(ServoWire):
    """A plug-in that starts a servo with its first angle."""

    energised: frozenset[int] = frozenset()

    def open(self) -> None:
        pass

    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        moved = {servo_id for servo_id, angle_deg in changes if angle_deg is not None}
        assert len(moved) in (0, len(changes)), "a call has only Stops, or none"
        self.energised = self.energised | moved if moved else self.energised - {servo_id for servo_id, _ in changes}

    def close(self) -> None:
        pass


def with_the_journals_token(effect: events.Effect) -> events.Effect:
    if not isinstance(effect, events.RequestAnswer) or effect.token is None:
        return effect
    return replace(effect, token=journal.token_text(journal.token_number(effect.token)))


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
        self.plugged = Plugged({})
        self.plugin = PluginDevice("plugged", self.plugged, exclusive=False)
        self.keyframes = journal.Keyframes(self.supervisor)
        self.played = journal.restored(self.keyframes.take())
        """Began with a keyframe, and takes the journal's events."""
        self.number = 1
        self.instant_ns: int | None = None
        if self.now_ns > 1:  # else it may be opened later, or not at all
            self.step(events.BusOpened())
            if rules.power:
                self.step(events.PowerSeen(alive=True))
            if rules.min_battery_mv:
                self.step(events.BodyMeasured(None, 7400))

    def step(self, event: events.Event, wait_ns: int = 0) -> None:
        """One step as the service takes it: write the frames, and tell of a transfer that failed. Or none, in a mode in
        which the event may not come."""
        mode = self.supervisor.mode
        if type(event) not in TRANSITIONS[mode]:
            return
        self.now_ns += wait_ns
        both_ways(self.supervisor, event, self.now_ns, self.instant_ns)
        without = replace(event, source=None) if isinstance(event, events.Command) else event
        effects = self.supervisor.step(event, self.now_ns, self.instant_ns)
        nameless = self.nameless.step(without, self.now_ns, self.instant_ns)
        if not self.supervisor._rules.takeover_cdeg_s:
            named = announced([*effects, *nameless], {Kind.SOURCE_CHANGED, Kind.LEGS_STOPPED})
            one, other = ([numbered(each) for each in both if each not in named] for both in (effects, nameless))
            same = one == other
            demand(same, "the source of commands changes only events, and the speed of a take-over")
        demand(self.supervisor.mode in TRANSITIONS[mode][type(event)], f"{mode} leads to {self.supervisor.mode}")
        self.oracle.judge(event, self.now_ns, effects, self.supervisor, self.instant_ns)
        written = to_json(journal.plain_event(event))  # after its step, as the black box writes it
        played = self.played.step(journal.event_of(from_json(written)), self.now_ns, self.instant_ns)
        assert list(map(numbered, played)) == [numbered(with_the_journals_token(each)) for each in effects]
        fault: SpiError | None = None
        batches: dict[bool, list[Transfer]] = {True: [], False: []}
        for effect in effects:
            if isinstance(effect, events.Transmit) and (fault is None or effect.frame.is_stop):
                data = effect.frame.data
                assert decode(data) == effect.frame
                try:
                    self.controller.take(data)
                    batches[effect.frame.is_stop].append((data, 0))
                except SpiError as error:
                    fault = error
        for batch in filter(None, batches.values()):
            self.plugin.transfer(batch)
        if fault is not None:
            self.step(events.BusFailed(str(fault)))

    @rule(
        command=COMMANDS, change=CHANGES, body=BODIES, board=BOARDS, rarely=st.integers(0, 99), data=st.data(),
        instant=st.sampled_from([*[""] * 8, "begins", "ends"]), fails=st.sampled_from([*[None] * 40, 0, 1, 3]),
    )  # fmt: skip
    def something_happens(
        self,
        command: tuple[str, Targets],
        change: CalibrationCommand,
        body: tuple[int | None, int],
        board: events.PowerSeen,
        rarely: int,
        data: st.DataObject,
        instant: str,
        fails: int | None,
    ) -> None:
        """One of what the model check tries: mostly commands while all goes well.

        What comes from the beginning of an instant to its end was collected together, and takes time to deal with.
        """
        if instant:
            self.now_ns += 1
            self.instant_ns = self.now_ns if instant == "begins" else None
        if rarely % 10 == 0:
            self.played = journal.restored(self.keyframes.take())
        if fails is not None:
            self.controller.fail_next(fails)
        rules, mode, due_ns = self.supervisor._rules, self.supervisor.mode, self.supervisor.due_ns
        about = Configuration(
            "any robot",
            rules,
            (command,),
            drivers=("anna", "ben"),
            buttons=("kitchen",) if rules.buttons_required else (),
            changes=(change,),
            bodies=(body,),
            boards=(board,) if rules.power else (),
            unread=(command[1],) if all(op is STOP for _, op in command[1]) else (),
            calm=rarely > 10 and mode in (Mode.IDLE, Mode.ACTIVE),
            ends=rarely < 3,
        )
        found = defaultdict[type[events.Event], list[events.Event]](list)
        for _, event in candidates(about, State(self.supervisor, self.oracle, number=self.number), self.now_ns):
            found[type(event)] += [event] * (type(event) in TRANSITIONS[mode])
        self.number += 1
        kind = data.draw(st.sampled_from([kind for kind in found for _ in range(OFTEN.get(kind, 1)) if found[kind]]))
        event, wait_ns, wakes_up = data.draw(st.sampled_from(found[kind])), data.draw(WAITS_NS), False
        if kind is events.TimePassed and due_ns is not None and rarely % 2:
            wait_ns, wakes_up = max(0, due_ns - self.now_ns) + rarely % 5 // 3, True
        if kind is events.BusOpened:
            self.controller.fail_next(0)
        self.step(event, wait_ns)
        due_ns = self.supervisor.due_ns
        assert not wakes_up or due_ns is None or due_ns > self.now_ns, "waking up makes progress"

    @invariant()
    def the_robot_is_as_everybody_believes(self) -> None:
        assert not self.controller.corruptions
        if self.supervisor.mode in (Mode.IDLE, Mode.ACTIVE, Mode.ESTOPPED):
            running = {servo.servo_id for servo in self.supervisor.legs.servos.values() if servo.running}
            assert self.controller.energised == running == self.oracle.energised == self.plugged.energised

    @invariant()
    def what_is_due_is_known(self) -> None:
        """Check that the usual way leaves the previous due time, which may be early, and never late."""
        legs = self.supervisor.legs
        due_ns, others = legs.due_ns, (legs.stops.due_ns, legs.at_rest)
        legs.plan(self.now_ns)
        assert others == (legs.stops.due_ns, legs.at_rest)
        assert due_ns == legs.due_ns or (due_ns is not None and legs.due_ns is not None and due_ns < legs.due_ns)

    @invariant()
    def nothing_is_forgotten(self) -> None:
        assert pending(self.supervisor).keys() == self.oracle.pending.keys()


TestSupervisorMachine = SupervisorMachine.TestCase
TestSupervisorMachine.settings = settings(max_examples=100, stateful_step_count=50, deadline=None)
