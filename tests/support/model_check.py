"""An exhaustive check of the supervisor: every state that small robots can reach, each step judged by the oracle.

Breadth first from a supervisor that has just been made: in every state, every event that `TRANSITIONS` allows there is
tried at every distance in time that the configuration has: at once (the same instant), a tick later, in the same
instant or in one of its own, and so late that several deadlines are jumped over. Two states are one if nothing in them
differs relative to now, so the clock does not make them infinite, and the search ends when no step leads to a new one:
no depth limits it. What is small is the robot (one or two legs, a few commands, one or two angles) and the resolution
of time (a tick is half a leg's period, or a quarter of it).
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any, Final

from gateway.model.calibration import RobotCalibration
from gateway.rate_limit import NS_PER_MS
from gateway.robot.core import events
from gateway.robot.core.backlog import Stretch
from gateway.robot.core.buttons import Buttons, Registration
from gateway.robot.core.gates import Gates
from gateway.robot.core.interlock import Interlock
from gateway.robot.core.lease import RobotLease
from gateway.robot.core.leg import Leg, RateSlots
from gateway.robot.core.legs import Legs
from gateway.robot.core.power_rule import PowerRule
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import Servo
from gateway.robot.core.stops import Repeats, StopSchedule
from gateway.robot.core.supervisor import Supervisor
from schemas.calibration import CalibrationCommand
from schemas.words import Kind, Mode, Reason
from tests.support.calibration_history import CalibrationHistory
from tests.support.history import STOP_SERVOS, Violation, cloned, demand, frames_of, numbered, speed_age_ns
from tests.support.oracle import Oracle
from tests.support.request_history import ButtonsHistory, LeaseHistory, Rhythm
from tests.support.small_robots import Configuration
from tests.support.transitions import TRANSITIONS


@dataclass(frozen=True, slots=True)
class Report:
    """What a search saw, and whether it has visited every state."""

    states: int
    steps: int
    whole: bool


# ---- states: copied, and distinguished


_ROBOT: Final = Supervisor(Rules())
_KNOWN: Final = (
    (
        _ROBOT,
        "_rules legs lease buttons body power backlog calibrating _opened _fault latch _ended outside watchdog",
    ),
    (_ROBOT, "_interlocks _of_legs _own mode due_ns"),
    (_ROBOT, "usual_ns _has_usual"),  # `both_ways` shows that they change nothing
    (_ROBOT.outside, "_rules _legs"),
    (_ROBOT.watchdog, "_rules _legs expirations"),
    (_ROBOT.latch, "_rules _legs number since_ns unknown"),
    (_ROBOT.lease, "_rules _legs holder _holder_id since_ns due_ns closed _token _askers"),
    (_ROBOT.buttons, "_rules _legs _by_token closed alive due_ns objection down"),
    (_ROBOT.body, "_rules _legs watches low unknown closed beyond_ns objection"),
    (_ROBOT.power, "_rules _legs alive closed trusted _blocked _withheld _asked _cut"),
    (_ROBOT.power, "_cause"),  # follows from mode and latch
    (_ROBOT.backlog, "_rules _legs _stretches _judged_ns held"),
    (Stretch, "begun_ns last_ns count instant_ns score servos"),
    (Registration, "name holder counts count until_ns source_id silent offset_ns newest_ns least_ns"),
    (_ROBOT.legs.limits, "of_settings pose_of_settings avoid_cdeg calibration wire limited free_cdeg"),
    (_ROBOT.calibrating, "_rules _legs _limits fault saving"),
    (_ROBOT.legs, "_rules limits by_number _all servos gates _pace stops sends instant_ns _halted"),
    (_ROBOT.legs, "landing_ends_ns landing_from_ns stopped_ns"),
    (_ROBOT.legs, "due_ns at_rest"),  # these follow from the others: `take` sees to that
    (_ROBOT.legs.gates, "supply stagger burst _together"),
    (_ROBOT.legs.gates.burst, "judged_ns"),
    (_ROBOT.legs.gates.supply, "_legs fed"),
    (_ROBOT.legs.gates.stagger, "pause_ns next_ns"),
    (_ROBOT.legs.stops, "_rules _legs _repeats _round_ns _settled_ns _runs_left runs"),
    (_ROBOT.legs.stops, "due_ns"),  # follows from the others
    (_ROBOT.legs.stops, "sent silent _first"),  # these count within a step
    (Repeats, "left due_ns"),
    (Leg, "number servos slots commanded_ns expired sender unfed_ns steady_for"),
    (Servo, "servo_id life angle_cdeg target command begun from_cdeg pace_cdeg_s since_ns passing_cdeg"),
    (Servo, "sender known stopped_ns stopped_by"),
    (RateSlots, "period_ns oldest_ns next_ns taken_ns _kept_ns _least_ns"),
    (
        events.Command,
        "targets key source source_id sent_ms lease reply verb received_ns number lost rejected moves frames",
    ),  # these never change
    (events.Command, "written stopped"),  # by the executor
    (events.Command, "left coalesced"),
)
"""All fields of a supervisor. A new field may matter to which states are equal: then add it to `key`, too."""
for _part in dict(_KNOWN):
    _names = {each.name for each in fields(_part)} if isinstance(_part, type) else vars(_part).keys()
    _expected = {name for part, names in _KNOWN if part is _part for name in names.split()}
    if _names != _expected:
        raise TypeError(f"{_part} has the fields {_names}; the model checker knows {_expected}")


def _getter(kind: type) -> "attrgetter[tuple[Any, ...]]":
    """Return a function that reads all fields of a dataclass."""
    return attrgetter(*(each.name for each in fields(kind)))


_servo_fields, _leg_fields = _getter(Servo), _getter(Leg)


def _with_legs(legs: Legs, by_number: dict[int, Leg]) -> None:
    legs.by_number, legs._all = by_number, tuple(by_number.values())
    legs.servos = {servo.servo_id: servo for leg in by_number.values() for servo in leg.servos}
    supply, stagger = legs.gates.supply, legs.gates.stagger
    legs.gates = Gates(legs._rules, by_number)
    legs.gates.supply.fed, legs.gates.stagger.next_ns = supply.fed, stagger.next_ns
    repeats = {servo_id: replace(legs.stops._repeats[servo_id]) for servo_id in legs.servos}
    legs.stops = cloned(legs.stops, _legs=legs._all, _repeats=repeats)


def small(supervisor: Supervisor, legs: Iterable[int]) -> Supervisor:
    """Remove all other legs from a robot, and return it."""
    _with_legs(supervisor.legs, {number: supervisor.legs.by_number[number] for number in legs})
    return supervisor


def pending(supervisor: Supervisor) -> dict[int, events.Command]:
    """Return the commands that servos wait for, by their numbers, in order."""
    waiting = [servo.command for servo in supervisor.legs.servos.values() if servo.pending]
    return {command.number: command for command in sorted(waiting, key=attrgetter("number"))}


def _copied_servo(servo: Servo, commands: dict[int, events.Command]) -> Servo:
    """Return a copy that waits for the copy of its command, which all servos share."""
    other = type(servo)(*_servo_fields(servo))
    if servo.target is not None:
        command = servo.command
        if command.number not in commands:
            commands[command.number] = copy(command)
        other.command = commands[command.number]
    return other


def _copied_interlocks(supervisor: Supervisor, legs: Legs) -> Iterator[Interlock[Any]]:
    """Yield copies that share nothing that changes."""
    for each in supervisor._interlocks:
        if isinstance(each, Buttons):
            by_token = {token: replace(button) for token, button in each._by_token.items()}
            yield cloned(each, _legs=legs, _by_token=by_token)
        elif isinstance(each, PowerRule):
            yield cloned(each, _legs=legs, _withheld=dict(each._withheld))
        else:
            yield cloned(each, _legs=legs)


def copied(supervisor: Supervisor) -> Supervisor:
    """Return a copy that shares nothing that changes; copy.deepcopy takes fifty times as long, pickle eight times."""
    legs = cloned(supervisor.legs)
    by_number: dict[int, Leg] = {}
    commands: dict[int, events.Command] = {}
    for number, leg in supervisor.legs.by_number.items():
        first, second, third = (_copied_servo(servo, commands) for servo in leg.servos)
        _, _, _, *rest = _leg_fields(leg)
        by_number[number] = type(leg)(number, (first, second, third), copy(leg.slots), *rest)
    _with_legs(legs, by_number)
    other = cloned(supervisor, legs=legs)
    other.connect(_copied_interlocks(supervisor, legs))
    legs.limits = other.calibrating._limits = cloned(supervisor.legs.limits)
    legs._pace = cloned(supervisor.legs._pace, _limits=legs.limits)
    backlog = supervisor.backlog
    stretches = {key: replace(stretch) for key, stretch in backlog._stretches.items()}
    judged_ns = legs.gates.burst.judged_ns = dict(backlog._judged_ns)
    other.backlog = cloned(backlog, _legs=legs, _stretches=stretches, _judged_ns=judged_ns, held=dict(backlog.held))
    return other


def _round_key(stops: StopSchedule, now_ns: int) -> tuple[object, ...]:
    """Return when the next Stops to legs at rest come, how many runs are left, and from when they count."""
    due_ns = None if stops._round_ns is None else max(0, stops._round_ns - now_ns)
    return due_ns, stops._runs_left, stops._runs_left and max(0, stops._settled_ns - now_ns)


def _repeats_key(repeats: Repeats, now_ns: int) -> object:
    return repeats.left and (repeats.left, max(0, repeats.due_ns - now_ns))


def _lease_key(lease: RobotLease, now_ns: int) -> tuple[object, ...]:
    """Return what still matters of the lease; one token is as good as another."""
    left_ns = None if lease.due_ns is None else lease.due_ns - now_ns
    return lease.holder, lease._token is not None, left_ns, lease.closed, lease._askers


def _buttons_key(buttons: Buttons, now_ns: int) -> tuple[object, ...]:
    """Return what still matters of the buttons; one token, and one count, is as good as another."""
    each = tuple(
        (button.name, button.until_ns and button.until_ns - now_ns, button.silent, button.offset_ns, button.least_ns)
        for button in buttons._by_token.values()
    )
    return each, buttons.closed, buttons.due_ns and buttons.due_ns - now_ns


def _body_key(supervisor: Supervisor, now_ns: int) -> tuple[object, ...]:
    """Return what still matters of the body's measurements."""
    body, tilt_ns = supervisor.body, supervisor._rules.tilt_ns
    age_ns = None if body.beyond_ns is None else now_ns - body.beyond_ns
    landing_ns = supervisor._rules.landing_ns
    return (
        body.low,
        body.unknown,
        body.down is not None,
        age_ns if age_ns is None else min(age_ns, tilt_ns + landing_ns),
    )


def _backlog_key(supervisor: Supervisor, now_ns: int) -> tuple[object, ...]:
    """Return what still matters of messages without a time."""
    backlog, rules = supervisor.backlog, supervisor._rules
    rhythms = {
        key: Rhythm(each.begun_ns, each.last_ns, each.instant_ns, each.count, each.score, each.servos).key(
            now_ns, rules
        )
        for key, each in backlog._stretches.items()
        if now_ns < each.last_ns + rules.quiet_ns
    }
    held = tuple(
        (servo_id, now_ns - backlog.held[servo_id], judged_ns - now_ns)
        for servo_id, judged_ns in backlog._judged_ns.items()
        if supervisor.legs.servos[servo_id].will_run
    )
    return tuple(sorted(rhythms.items())), held


def _calibration_key(calibration: RobotCalibration) -> tuple[object, ...]:
    """Return what distinguishes two calibrations; one revision is as good as another."""
    return tuple(sorted(calibration.servos.items())), tuple(sorted(calibration.landing_cdeg.items()))


def _calibrating_key(supervisor: Supervisor) -> tuple[object, ...]:
    """Return what still matters of a calibration and its change."""
    calibrating, limits = supervisor.calibrating, supervisor.legs.limits
    saving = calibrating.saving
    return (
        _calibration_key(limits.calibration),
        limits.wire is not None,
        limits.limited,
        calibrating.fault,
        calibrating.closed,
        saving and (_calibration_key(saving[1]), saving[0].change.accept_default),
    )


def _takeover_key(legs: Legs, servo: Servo, now_ns: int) -> tuple[object, ...]:
    """Return whose servo it is, and its angle at rest for as long as this counts as known."""
    stood = None
    if servo.known is not None and not servo.running:
        angle_cdeg, stopped_ns, calibration = servo.known
        if calibration is legs.limits.calibration and now_ns - stopped_ns <= legs._rules.takeover_known_ns:
            stood = angle_cdeg, now_ns - stopped_ns
    return servo.sender, stood


def key(supervisor: Supervisor, now_ns: int, rank: dict[int, int]) -> tuple[object, ...]:
    """Return what of a state still matters, relative to now; `rank` numbers the pending commands by age.

    Left out: counters; times of things that are over; how long ago, where longer makes no difference.
    """
    legs, power, due_ns = supervisor.legs, supervisor.power, supervisor.due_ns
    stagger = legs.gates.stagger
    latched_ns, oldest_ns = supervisor.latch.since_ns, legs._rules.unnumbered_reset_ns
    return (
        supervisor.mode,
        supervisor._opened,
        legs.sends,
        supervisor._fault,
        supervisor._ended,
        supervisor.latch.unknown,
        supervisor.outside.closed,
        min(now_ns - legs.instant_ns, oldest_ns),  # an emergency stop that is still to come counts from its instant
        # How old it is for a reset of this instant, and of one that begins now.
        latched_ns and (min(legs.instant_ns - latched_ns, oldest_ns), min(now_ns - latched_ns, oldest_ns)),
        due_ns and max(0, due_ns - now_ns),
        legs.sends and _round_key(legs.stops, now_ns),
        _lease_key(supervisor.lease, now_ns),
        _buttons_key(supervisor.buttons, now_ns),
        _body_key(supervisor, now_ns),
        (power.alive, power.closed, power.trusted, power._cut, legs.gates.supply.fed),
        (tuple(power._blocked), tuple(sorted(power._withheld)), tuple(power._asked.items())),
        _backlog_key(supervisor, now_ns),
        _calibrating_key(supervisor),
        legs.landing_ends_ns and (legs.landing_ends_ns - now_ns, max(0, legs.landing_from_ns - now_ns)),
        stagger.pause_ns and max(0, stagger.next_ns - now_ns),
        tuple((rank[number], each.left, each.coalesced) for number, each in pending(supervisor).items()),
        tuple(
            (
                min(now_ns - leg.commanded_ns, legs._rules.timeout_ns)
                if leg.commanded_ns is not None and leg.armed
                else None,
                leg.expired,
                leg.unfed_ns is not None and now_ns - leg.unfed_ns,
                max(leg.slots.oldest_ns - now_ns, -2 * leg.slots.period_ns),  # then the bucket is full
                max(leg.slots.next_ns - now_ns, 0),
                legs._rules.takeover_cdeg_s and speed_age_ns(leg.slots.taken_ns, now_ns, legs._rules),
                tuple(
                    (
                        servo.angle_cdeg,
                        servo.life,
                        servo.target and (servo.target, servo.begun, rank.get(servo.command.number)),
                        servo.pace_cdeg_s,
                        servo.from_cdeg,
                        servo.passing_cdeg,
                        speed_age_ns(servo.since_ns, now_ns, legs._rules) if servo.running else None,
                        legs._rules.takeover_cdeg_s and _takeover_key(legs, servo, now_ns),
                        # A bus that opens again gets a Stop for every leg.
                        legs.sends and _repeats_key(legs.stops._repeats[servo.servo_id], now_ns),
                        servo.stopped_by if servo.stopped_ns == legs.instant_ns else None,
                    )
                    for servo in leg.servos
                ),
            )
            for leg in legs
        ),
    )


# ---- the search


def _tokens(drivers: Sequence[str], lease: LeaseHistory) -> Iterator[tuple[str, str | None]]:
    """Yield the tokens that a command may carry: none, that of the lease, or that of a lease that has ended."""
    yield "", None
    if drivers and lease.token is not None:
        yield " of the holder", lease.token
    if drivers and lease.old_token is not None:
        yield " of a former holder", lease.old_token


def _lease_requests(drivers: Sequence[str], number: int, lease: LeaseHistory) -> Iterator[tuple[str, events.Event]]:
    """Yield each request for the lease that each driver may make, with a name; a new token is one that nobody had."""
    fresh = f"token {number}"
    for name in drivers:
        for do in ("acquire", "ask", "take"):
            yield f"{name} wants to {do}", events.LeaseRequest(do, name, fresh_token=fresh)
    for whose, token in _tokens(drivers, lease):
        if token is not None:
            yield f"renewal{whose}", events.LeaseRequest("renew", token=token)
            yield f"release{whose}", events.LeaseRequest("release", token=token)
            yield f"handover{whose}", events.LeaseRequest("release", token=token, to=drivers[-1])


def _button_requests(
    names: Sequence[str], number: int, now_ns: int, delays_ns: Sequence[int], buttons: ButtonsHistory
) -> Iterator[tuple[str, events.Event]]:
    """Yield each request that each button may make, with a name; a new token is one that nobody had.

    A check-in is the next one, or the latest one again; it says when it was sent (so long ago), or does not.
    """
    for name in names:
        register = events.ButtonRequest("register", now_ns, name, fresh_token=f"token {number}")
        yield f"{name} registers", register
        for delay_ns in delays_ns:
            yield f"{name} registers, {delay_ns} late", replace(register, sent_ms=(now_ns - delay_ns) / NS_PER_MS)
    tokens = [*buttons.known, *([] if buttons.old_token is None else [buttons.old_token])]
    for token in tokens if names else ():
        whose = buttons.known[token].name if token in buttons.known else "a former button"
        count = buttons.known[token].count if token in buttons.known else number
        alive = events.ButtonRequest("alive", now_ns, token=token, count=count + 1)
        yield f"{whose} is alive", alive
        yield f"a check-in of {whose} once more", replace(alive, count=count)
        for delay_ns in delays_ns:
            yield f"{whose} was alive {delay_ns} ago", replace(alive, sent_ms=(now_ns - delay_ns) / NS_PER_MS)
        yield f"{whose} leaves", events.ButtonRequest("leave", now_ns, token=token)


def _changes(
    wanted: Sequence[CalibrationCommand], number: int, history: CalibrationHistory
) -> Iterator[tuple[str, events.Event]]:
    """Yield each change of the calibration that may be asked for, and each answer of the disk, with a name."""
    revision = history.whole.revision
    for which, change in enumerate(wanted):
        now = {"revision": revision, "accept_default": None if history.trusted else True}
        yield f"calibration {which}", events.Calibrate(number=number, change=change.model_copy(update=now))
    if wanted:
        older = wanted[0].model_copy(update={"revision": revision - 1})
        yield "calibration of an older one", events.Calibrate(number=number, change=older)
        default = CalibrationCommand(servos={}, landing={}, accept_default=True if history.trusted else None)
        yield "another default accepted", events.Calibrate(number=number, change=default)
    if history.on_its_way is not None:
        yield "calibration kept", events.CalibrationSaved(history.on_its_way.number)
        yield "calibration not kept", events.CalibrationSaved(history.on_its_way.number, "the disk is full")


def candidates(configuration: Configuration, state: "State", now_ns: int) -> Iterator[tuple[str, events.Event]]:
    """Yield each event that can come then, with a name."""
    mode, number, estops, oracle = state.supervisor.mode, state.number, state.supervisor.latch.number, state.oracle
    lease, calibration, buttons = oracle.lease, oracle.calibration, oracle.buttons
    if oracle.unknown:
        yield "the disk is read", events.EstopKept(*oracle.disk)
        yield "the disk cannot be read", events.EstopKept(oracle.disk[0] + 1000, engaged=True)
    # Where every command is rejected, one is as good as another.
    commands = configuration.commands if mode in (Mode.IDLE, Mode.ACTIVE) else configuration.commands[:1]
    for which, (channel, targets) in enumerate(commands):
        for whose, token in _tokens(configuration.drivers, lease):
            by = next((name for name in ("anna", "ben") if f"{name}'s" in channel), None)
            timed = 1.0 if "with a time" in channel else None
            frames = frames_of(targets)
            command = events.Command(
                targets, frames=frames, key=channel, source=by, number=number, lease=token, sent_ms=timed
            )
            yield f"{channel} command {which}{whose}", command
    for stops in configuration.unread:
        unread = events.Rejected(events.Request(number=number), Reason.MALFORMED, "a test's")
        yield f"what may stop {len(stops)}", events.Command(stops, key="unread", number=number, rejected=unread)
    for tilt_cdeg, battery_mv in configuration.bodies:
        yield f"tilt {tilt_cdeg}, battery {battery_mv}", events.BodyMeasured(tilt_cdeg, battery_mv)
    for seen in configuration.boards:
        yield str(seen), seen
    yield "time passed", events.TimePassed()
    yield "bus opened", events.BusOpened()
    yield from _lease_requests(configuration.drivers, number, lease)
    yield from _button_requests(configuration.buttons, number, now_ns, configuration.delays_ns, buttons)
    yield from _changes(configuration.changes, number, calibration)
    if configuration.calm and not configuration.ends:
        return
    yield "emergency stop", events.EmergencyStop()
    for whose, token in _tokens(configuration.drivers, lease):
        yield f"reset{whose}", events.Reset(number=number, estop=estops, lease=token)
    if mode is Mode.ESTOPPED:
        yield "reset of an older one", events.Reset(number=number, estop=estops - 1)
        yield "reset of none that was", events.Reset(number=number, estop=estops + 1)
        yield "reset without a number", events.Reset(number=number)
    yield from STOP_SERVOS.items()
    yield "bus failed", events.BusFailed("a test's fault")
    if configuration.bodies:
        yield "controller silent", events.BusFailed("a test's fault", Kind.CONTROLLER_SILENT)
        yield "controller restarted", events.BusFailed("a test's fault", Kind.CONTROLLER_RESTARTED)
    if configuration.ends:
        yield "shut down", events.ShutDown()


@dataclass(slots=True)
class State:
    """A supervisor, its judge, the time, and the way there: the events back to the first."""

    supervisor: Supervisor
    oracle: Oracle
    now_ns: int = 1000
    instant_ns: int = 1000
    number: int = 1
    way: "Way | None" = None
    make: Callable[[Rules], Supervisor] = Supervisor
    """Starts a gateway."""

    def path(self) -> str:
        """Return the way there in words: how many nanoseconds later which event came."""
        names: list[str] = []
        way = self.way
        while way is not None:
            way, name = way
            names.append(name)
        return ", ".join(reversed(names))


Way = tuple["Way | None", str]
Key = tuple[tuple[object, ...], tuple[object, ...]]


def start(configuration: Configuration, make: Callable[[Rules], Supervisor] = Supervisor) -> State:
    """Return the state of a robot that has just been made."""
    supervisor = small(make(configuration.rules), configuration.legs)
    kept, fault = configuration.calibration or RobotCalibration(), configuration.fault
    supervisor.calibrating.load(kept, fault)
    return State(supervisor, Oracle(configuration.rules, configuration.legs, kept, fault), make=make)


def outlasting(configuration: Configuration, state: State) -> Iterator[State]:
    """Yield the states after the disk has written the emergency stop, and after another gateway starts with it."""
    wanted = state.oracle.estops, state.oracle.latched_ns is not None
    if not configuration.rules.estop_kept:
        return
    if not state.oracle.unknown and state.oracle.disk != wanted:
        oracle = state.oracle.clone()
        oracle.disk = wanted
        yield replace(state, oracle=oracle, way=(state.way, "the disk has it"))
    again = start(configuration, state.make)
    again.oracle.disk = state.oracle.disk
    way = (state.way, "the gateway is killed and starts again")
    yield replace(again, now_ns=state.now_ns, instant_ns=state.now_ns, number=state.number, way=way)


def looks(state: State) -> "Key":
    """Return what distinguishes a state from others."""
    rank = {number: age for age, number in enumerate(sorted(state.oracle.pending))}
    return key(state.supervisor, state.now_ns, rank), state.oracle.key(state.now_ns, rank)


def successors(configuration: Configuration, state: State) -> Iterator[tuple[Key, State]]:
    """Yield each next state. Raise Violation if a promise is broken."""
    mode = state.supervisor.mode
    for after in outlasting(configuration, state):
        yield looks(after), after
    waits = [(wait_ns, wait_ns == 0) for wait_ns in configuration.waits_ns]
    waits += [(wait_ns, True) for wait_ns in configuration.within_ns]
    for wait_ns, same_instant in waits:
        now_ns = state.now_ns + wait_ns
        for name, event in candidates(configuration, state, now_ns):
            if type(event) not in TRANSITIONS[mode]:
                continue
            supervisor, oracle = copied(state.supervisor), state.oracle.clone()
            way = (state.way, f"+{wait_ns}{' in the same instant' if wait_ns and same_instant else ''} {name}")
            instant_ns = state.instant_ns if same_instant else now_ns
            after = State(supervisor, oracle, now_ns, instant_ns, state.number + 1, way, state.make)
            try:
                take(supervisor, oracle, event, now_ns, instant_ns)
            except (Violation, LookupError, ValueError) as broken:
                raise Violation(f"{configuration.name}: {broken!r}; the way there: {after.path()}") from broken
            yield looks(after), after


def take(supervisor: Supervisor, oracle: Oracle, event: events.Event, now_ns: int, instant_ns: int) -> None:
    """Take one step, and judge it. Raise Violation."""
    mode, due_ns = supervisor.mode, supervisor.due_ns
    both_ways(supervisor, event, now_ns, instant_ns)
    effects = supervisor.step(event, now_ns, instant_ns)
    allowed = TRANSITIONS[mode][type(event)]
    demand(supervisor.mode in allowed, f"{type(event).__name__} leads {mode} to {supervisor.mode}")
    oracle.judge(event, now_ns, effects, supervisor, instant_ns)
    if isinstance(event, events.TimePassed) and due_ns is not None and due_ns <= now_ns:
        demand(bool(effects) or supervisor.due_ns != due_ns, "waking up at the deadline changes something")


def both_ways(supervisor: Supervisor, event: events.Event, now_ns: int, instant_ns: int | None) -> None:
    """Let copies take a command in the usual and in the general way. Raise Violation if they differ in anything but
    an early `due_ns`."""
    if not isinstance(event, events.Command) or now_ns >= supervisor.usual_ns:
        return
    usual, general = copied(supervisor), copied(supervisor)
    general.usual_ns = 0
    effects = [list(map(numbered, each.step(copy(event), now_ns, instant_ns))) for each in (usual, general)]
    demand(effects[0] == effects[1], f"the usual way does the same: {effects}")
    usual.legs.plan(now_ns)
    dues = [(each.legs.due_ns, each.legs.stops.due_ns) for each in (usual, general)]
    demand(dues[0] == dues[1], f"the usual way leaves the same to do: {dues}")
    demand((usual.due_ns or now_ns) <= (general.due_ns or math.inf), "the usual way is never late")
    usual.due_ns = general.due_ns
    usual.legs.gates.supply.begin()  # as each step begins
    general.legs.gates.supply.begin()
    rank = {number: age for age, number in enumerate(sorted(pending(general)))}
    demand(key(usual, now_ns, rank) == key(general, now_ns, rank), "the usual way leads to the same state")


def check(
    configuration: Configuration, make: Callable[[Rules], Supervisor] = Supervisor, *, most_states: float = math.inf
) -> Report:
    """Visit every reachable state, the nearest first, until `most_states` are known. Raises Violation, with the
    shortest way to it, where a promise is broken."""
    seen: set[Key] = set()
    frontier = deque([start(configuration, make)])
    steps = 0
    while frontier and len(seen) < most_states:
        for found, state in successors(configuration, frontier.popleft()):
            steps += 1
            if found not in seen:
                seen.add(found)
                frontier.append(state)
    return Report(len(seen), steps, whole=not frontier)
