"""The rules of safety: a pure state machine, `step(event, now_ns)` → what to send and report.

No I/O, no clock, no logger. Time is an argument, in ns of the monotonic clock, and never goes back. The service carries
out the effects in their order. If a frame cannot be written, `BusFailed` follows.

A step has this order; the code has the same numbers:

0. A setpoint for running servos that meets no rule goes the usual way, and the step ends.
1. Deadlines of the rules that have one of their own: lease, buttons.
2. What brings the robot down: a rule under which no servo may run.
3. Deadlines of legs: a command's, and the power board's. An event comes after deadlines, for which it is too late.
4. What the event halts. A halt voids 2 and 3.
5. Starts that have waited long enough to be judged, unless the event stops all servos.
6. The event itself.
7. What became due: repeated Stops, and frames whose rate slot has come, which the event may have used.
8. Stops for legs at rest.
9. The plan: what is due next, and the mode. Stops precede all other effects.
10. The supply: its cuts precede the Stops, and servos are fed after the frames.

Each rule that may keep the robot from moving, or bring it down, is an `Interlock` (lease, buttons, body, power,
calibration, landing, `stop-servos`, emergency stop), in the `ORDER` below. A request is rejected with the reason of the
first interlock that objects. A rule's Stops precede the answer to its event.

Further rules, here and in `Legs`, by their names in docs/interface.md, *Behaviour*:

*Start*: Before the first `BusOpened`, nothing is accepted. It stops all six legs, at the start and after a fault.
*Answered in part*: Of a rejected command, the Stops are carried out, whatever the reason.
*Bus fault*: `BusFailed` drops waiting commands. Until `BusOpened` nothing is sent, and every request is rejected. The
    latch of an emergency stop remains.
*End*: `ShutDown` rejects all further events except an emergency stop. A bus that answers again only then still gets its
    Stops.

Within one instant, the order of messages from different channels is unknown. So a Stop wins over a Start or Set of
another channel, and the emergency stop wins over a reset.
"""

from collections.abc import Iterable
from typing import Any, Final, get_args

from gateway.model.frames import OP_SET, Frame
from gateway.robot.core.backlog import Backlog
from gateway.robot.core.body_limits import BodyLimits
from gateway.robot.core.buttons import Buttons
from gateway.robot.core.calibrating import Calibrating
from gateway.robot.core.events import (
    Announce,
    BodyMeasured,
    BusFailed,
    BusOpened,
    ButtonRequest,
    Calibrate,
    Command,
    Effect,
    EmergencyStop,
    EstopKept,
    Event,
    LeaseRequest,
    PowerSeen,
    Rejected,
    RequestAnswer,
    Reset,
    ShutDown,
    TimePassed,
    Transmit,
)
from gateway.robot.core.gates import NEVER
from gateway.robot.core.interlock import Barred, Interlock, Why
from gateway.robot.core.latch import ESTOPPED, Latch
from gateway.robot.core.lease import RobotLease
from gateway.robot.core.legs import Halt, Legs, moves_of
from gateway.robot.core.outside import Outside
from gateway.robot.core.power_rule import PowerRule
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import moved
from gateway.robot.core.watchdog import Watchdog
from schemas.words import Cause, Kind, Mode, Reason

_STOPPING: Final = "the gateway is ending"
_REJECTING: Final = {
    Mode.ESTOPPED: (Reason.ESTOPPED, ESTOPPED),
    Mode.BUS_FAULT: (Reason.BUS_FAULT, ""),  # `Rules.wire_fault`
    Mode.STOPPING: (Reason.STOPPING, _STOPPING),
}
"""The modes in which every command is rejected, and why."""
_STOPS_ALL: Final = frozenset({BusOpened, BusFailed, ShutDown})
"""These events, and a Halt, void due deadlines, and reject waiting starts even if their judgement is due."""
_NOT_AT_THE_END: Final = frozenset({LeaseRequest, ButtonRequest, PowerSeen})
ORDER: tuple[type[Interlock[Any]], ...] = (
    Outside,
    RobotLease,
    Watchdog,
    Buttons,
    BodyLimits,
    PowerRule,
    Calibrating,
    Latch,
)
"""The interlocks, in the order in which they may object. A new rule is a file, and a line here."""

_AT_START: Final[frozenset[type[Event]]] = frozenset(
    {EmergencyStop, EstopKept, BusOpened, BusFailed, BodyMeasured, PowerSeen, TimePassed, ShutDown}
)
ALL_EVENTS: Final[frozenset[type[Event]]] = frozenset(get_args(Event))
LEGAL: Final = {mode: ALL_EVENTS - {BusOpened, EstopKept} for mode in (Mode.IDLE, Mode.ACTIVE)} | {
    Mode.ESTOPPED: ALL_EVENTS - {BusOpened},
    Mode.STARTING: _AT_START,
    Mode.BUS_FAULT: ALL_EVENTS,
    Mode.STOPPING: ALL_EVENTS,
}
"""The events that each mode accepts. Any other is a mistake of the caller."""


class IllegalEvent(RuntimeError):  # noqa: N818  (h11 and friends: it names what happened)
    """The caller sent an event that this mode does not accept; the state is unchanged."""


class Supervisor:
    """Decides what reaches the robot. One owner, one thread."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.legs = Legs(rules)
        self.backlog = Backlog(rules, self.legs)
        self.connect(each(rules, self.legs) for each in ORDER)
        self._opened = False  # ever
        self._fault = Kind.BUS_FAULT  # the announced fault, while there is one
        self._ended = False
        self.mode = Mode.STARTING
        self.due_ns: int | None = None
        """When to send `TimePassed`; None: another event comes first."""
        self.usual_ns = 0
        """Until when a command that moves running servos may go the usual way (ns), or 0 if it must not."""
        self._has_usual = not rules.max_speed_cdeg_s

    def connect(self, interlocks: Iterable[Interlock[Any]]) -> None:
        """Use these interlocks, in this order."""
        found: dict[type, Any] = {type(each): each for each in interlocks}
        self._interlocks: tuple[Interlock[Any], ...] = tuple(found.values())
        self._of_legs = tuple(each for each in reversed(self._interlocks) if each.of_legs)
        """The watchdog last: it lands no robot for a leg that another rule stops."""
        self._own = {event: each for each in self._interlocks for event in each.takes}
        self.outside: Outside = found[Outside]
        self.lease: RobotLease = found[RobotLease]
        self.watchdog: Watchdog = found[Watchdog]
        self.buttons: Buttons = found[Buttons]
        self.body: BodyLimits = found[BodyLimits]
        self.power: PowerRule = found[PowerRule]
        self.calibrating: Calibrating = found[Calibrating]
        self.latch: Latch = found[Latch]

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:  # noqa: PLR0912
        """Take one event, and return its effects in order.

        Events with the same `instant_ns` (default: `now_ns`) were collected together, in an unknown order. Raises
        IllegalEvent, and changes nothing, if this mode does not accept the event (`LEGAL`).
        """
        kind, legs = type(event), self.legs
        # 0. the usual way
        if type(event) is Command:
            usual = self.usual(event, now_ns, now_ns if instant_ns is None else instant_ns)
            if usual is not None:
                return [*moves_of(event, usual)]
        own = self._own.get(kind)
        if kind not in LEGAL[self.mode]:
            raise IllegalEvent(f"{kind.__name__} while {self.mode}")
        legs.begin(now_ns if instant_ns is None else instant_ns)
        effects: list[Effect] = []
        # 1. deadlines of rules
        for each in self._interlocks:
            if each.due_ns is not None and now_ns >= each.due_ns:
                effects += each.expire(now_ns)
        due = legs.sends and self.due_ns is not None and now_ns >= self.due_ns
        if self._ended and kind in _NOT_AT_THE_END:
            own = None
        halt = None if own is None else own.halts(event)
        # 2. what brings the robot down
        if halt is not None or kind in _STOPS_ALL:
            due = False
        else:
            for each in self._interlocks:
                effects += each.bring_down(now_ns)
        # 3. deadlines of legs
        if due:
            for each in self._of_legs:
                effects += each.expire(now_ns)
        self.watchdog.closed = legs.landing_ends_ns is not None
        # 4. what the event halts
        if halt is not None:
            effects += self._stop_all(halt, now_ns)
        # 5. starts that are judged
        if self.backlog.held and kind not in _STOPS_ALL:
            effects += self.backlog.expire(now_ns)
        # 6. the event
        effects += self._take(event, now_ns) if own is None else self._take_own(own, event, now_ns)
        # 7. what became due
        if due:
            effects += legs.stops.repeat(now_ns, at_rest=legs.at_rest)
            effects += legs.take_slots(now_ns)
        # 8. Stops for legs at rest
        if legs.sends:
            effects += legs.stops.round(now_ns, ran=not legs.at_rest, runs=legs.running)
        # 9. the plan
        legs.plan(now_ns)
        if legs.landing_ends_ns is not None and legs.at_rest:
            legs.landing_ends_ns = None  # clients have stopped all landing servos
        self.mode = self._mode_now()
        self.due_ns = legs.due_ns if legs.sends else None
        for each in self._interlocks:
            if each.due_ns is not None:
                self.due_ns = each.due_ns if self.due_ns is None else min(self.due_ns, each.due_ns)
        effects += legs.halted()
        effects = sorted(effects, key=_after_stops) if legs.stops.sent else effects
        # 10. the supply
        if self._rules.power:
            effects = self.power.supply(effects, self.mode, self.latch.number, outside=self.outside.closed)
        self.usual_ns = self._usual_until_ns()
        return effects

    def _usual_until_ns(self) -> int:
        """Return until when a command for running servos meets no rule but the lease (ns); 0: it may meet one now."""
        if self.mode is not Mode.ACTIVE or not self._has_usual or self.legs.landing_ends_ns is not None:
            return 0
        if self.backlog.held:  # a message may end its wait
            return 0
        if any(each.closed or each.down is not None for each in self._interlocks if each is not self.lease):
            return 0
        return NEVER if self.due_ns is None else self.due_ns

    def usual(self, command: Command, now_ns: int, instant_ns: int) -> tuple[Frame, ...] | None:
        """Take what most commands ask: running servos move on, within limits and rate slots, and no rule is due.

        Return the frames, which complete the command. They, and the state after them, are those of the general way, but
        for `due_ns`, which may be early (`unit/robot/test_supervisor_machine.py` compares them). Neither the mode, the
        emergency stop nor `due_ns` changes. Return None, and change nothing, if it is not such a command.
        """
        frames, token = command.frames, command.lease
        lease, legs = self.lease, self.legs
        if not frames or now_ns >= self.usual_ns or instant_ns == legs.stopped_ns or command.rejected is not None:
            return None
        if (lease.closed or token is not None) and lease.why_not(command) is not None:
            return None
        sender = command.source, command.source_id
        by_number, limits = legs.by_number, legs.limits
        for frame in frames:
            leg = by_number[frame.leg]
            if now_ns < leg.slots.next_ns or (leg.steady_for != sender and not leg.is_steady_for(sender)):
                return None
        if limits.limited and not limits.are_free(command.targets):
            return None
        moved(legs.servos, command.targets)
        for frame in frames:
            leg = by_number[frame.leg]
            leg.commanded_ns = now_ns
            leg.slots.take(now_ns)
        command.left = 0
        legs.instant_ns = instant_ns
        if token is not None:
            lease.record_use(token, now_ns)
        if command.sent_ms is None:
            self.backlog.note(command, now_ns)
        return frames if limits.wire is None else tuple(map(limits.wire.frame, frames))

    def _mode_now(self) -> Mode:
        if self._ended:
            return Mode.STOPPING
        if not self.legs.sends:
            return Mode.BUS_FAULT if self._opened else Mode.STARTING
        if self.latch.since_ns is not None or self.latch.unknown:
            return Mode.ESTOPPED
        return Mode.IDLE if self.legs.at_rest else Mode.ACTIVE

    # ---- events

    def _take(self, event: Event, now_ns: int) -> list[Effect]:
        match event:
            case Command():
                return self._command(event, now_ns)
            case BusOpened():
                return self._bus_opened(now_ns)
            case BusFailed():
                return self._bus_failed(event)
            case ShutDown():
                return self._shut_down(now_ns)
            case LeaseRequest() | ButtonRequest():
                return [RequestAnswer(Reason.STOPPING, _STOPPING)]
            case _:  # only time has passed, or the service ends
                return []

    def _take_own(self, own: Interlock[Any], event: Event, now_ns: int) -> list[Effect]:
        """Take an interlock's event. Any interlock may bar a request; an accepted one renews its sender's lease."""
        if not isinstance(event, Reset | Calibrate):
            effects = own.take(event, now_ns)
            for each in self._interlocks:
                effects = [*each.bring_down(now_ns), *effects]
            return effects
        why = self._why_not(event)
        if why is not None:
            return [Rejected(event, *why)]
        effects = own.take(event, now_ns)
        if isinstance(effects[0], Rejected):
            return effects
        if event.lease is not None:
            self.lease.record_use(event.lease, now_ns)
        return [*effects, *self.power.reset()] if self._rules.power and type(event) is Reset else effects

    def _command(self, command: Command, now_ns: int) -> list[Effect]:
        rejected = command.rejected
        if rejected is None:
            if command.sent_ms is None:
                self.backlog.note(command, now_ns)
            rejection = self._why_not(command) or self._why_not_moved(command)
            if rejection is None:
                if command.lease is not None:
                    self.lease.record_use(command.lease, now_ns)
                if command.sent_ms is None or self.backlog.held:
                    self.backlog.hold(command, now_ns)
                effects = self.legs.apply(command, now_ns)
                whole = self._rules.starts_whole and command.moves  # it may have released other legs' starts
                return [*effects, *self.legs.take_slots(now_ns)] if whole else effects
            rejected = Rejected(command, *rejection)
        return self.legs.stop_for(command, rejected, now_ns, write=not self._ended) if self.legs.sends else [rejected]

    def _why_not(self, request: Barred) -> Why | None:
        kind = type(request)
        if self.mode in _REJECTING and not (kind is Reset and self.mode is Mode.ESTOPPED):
            reason, detail = _REJECTING[self.mode]
            return reason, detail or self._rules.wire_fault
        if kind is not Command or request.moves:
            asked = None if request.lease is None else self.lease  # even a free lease objects to an old token
            for each in self._interlocks:
                if (each.closed or each is asked) and kind in each.bars:
                    why = each.why_not(request)
                    if why is not None:
                        return why
        return None

    def _why_not_moved(self, command: Command) -> Why | None:
        moves = command.moves
        limits = self.legs.limits
        for servo_id, op in moves if limits.limited else ():
            why_not = limits.why_not(servo_id, op.angle_cdeg)
            if why_not is not None:
                return Reason.JOINT_LIMIT, why_not
        servos, instant_ns = self.legs.servos, self.legs.instant_ns
        for servo_id, op in moves:
            servo = servos[servo_id]
            if servo.stopped_ns == instant_ns and not servo.stopped_by <= {command.channel}:
                # The order of the two is unknown, and an older Start must not overtake a Stop.
                by = ", ".join(sorted(servo.stopped_by))
                return Reason.SERVO_STOPPED, f"servo {servo_id} was stopped in the same instant ({by})"
            if op.op is OP_SET and not servo.will_run:
                return Reason.SERVO_STOPPED, f"servo {servo_id} does not run; start it before you set it"
        return self.legs.why_not_whole(command) if self._rules.starts_whole else None

    # mutants accepted (TrueWithFalse): nobody opens a bus that is open
    def _bus_opened(self, now_ns: int) -> list[Effect]:
        recovered, self._opened, self.legs.sends = self._opened, True, True
        effects = self._stop_all(Halt(Cause.STARTUP, Reason.BUS_FAULT, self._rules.wire_fault), now_ns)
        if recovered:
            who, kind = self._rules.wire, Kind.BUS_RECOVERED
            if self._fault is not Kind.BUS_FAULT:
                who, kind = "the controller", Kind.CONTROLLER_RETURNED
            self._fault = Kind.BUS_FAULT
            effects.append(Announce(kind, done=f"{who} answers again; all servos are stopped"))
        return effects

    def _bus_failed(self, event: BusFailed) -> list[Effect]:  # mutants accepted (Forget): done twice on purpose
        first, self.legs.sends, self._opened = self.legs.sends or not self._opened, False, True
        # A restarted controller that does not return is silent, which needs a person.
        stays_away = event.kind is Kind.CONTROLLER_SILENT and self._fault is Kind.CONTROLLER_RESTARTED
        self.legs.landing_ends_ns = None  # once the bus opens again, all legs are stopped and none lands
        self.legs.stops.forget()
        effects = self.legs.drop(self.legs.servos.values(), Reason.BUS_FAULT, self._rules.wire_fault)
        if first or stays_away:
            self._fault = event.kind
            effects.append(Announce(event.kind, event.detail))
        return effects

    def _shut_down(self, now_ns: int) -> list[Effect]:
        self._ended = True
        self.legs.stops.runs = 0
        self.lease.end()
        sends = self.legs.sends
        done = "all servos are stopped" if sends else f"{self._rules.wire} does not answer, so no Stop can be sent"
        announcement = Announce(Kind.STOPPING, "the gateway ends", done=done)
        return [*self._stop_all(Halt(Cause.SHUTDOWN, Reason.STOPPING, _STOPPING), now_ns), announcement]

    # mutants accepted (Forget): done twice on purpose
    def _stop_all(self, halt: Halt, now_ns: int) -> list[Effect]:
        legs = self.legs
        legs.landing_ends_ns = None  # a Stop of all legs ends a landing
        if not legs.sends:
            return legs.drop(legs.servos.values(), halt.reason, halt.detail)
        return legs.stop(dict.fromkeys(legs.by_number), halt, now_ns)


def _after_stops(effect: Effect) -> bool:
    """Sort key that puts Stops before frames that move, and before answers."""
    return not (isinstance(effect, Transmit) and effect.frame.is_stop)
