"""The rules of safety: a pure state machine, `step(event, now_ns)` → what to send and say.

No I/O, no clock, no logger: time is an argument (nanoseconds of the monotonic clock, never going back), and the effects
are carried out by the service in their order. If writing a frame fails, the service says so with `BusFailed`.

The rules, by their numbers in docs/interface.md, *Behaviour*:

 1. `BusOpened` stops all six legs, at the start and after a fault; nothing is accepted before.
 2. Only an accepted `start` energises a servo. A `set` for a servo that neither runs nor waits to be started is
    rejected, and the whole command with it. A Stop ends what waits for its servo: no older Start or Set comes after it.
 3. Starts and Sets wait for their leg's rate slot (`pacing`), newest target per servo. A Stop waits for nothing, and
    in what one step wants sent, all Stops come first.
    Of a command that is rejected, for whatever reason, the Stops are carried out, and nothing else (`Legs.stop_for`).
 4. A leg that runs, or waits to be started, is stopped when no accepted command starts or sets one of its servos for
    the timeout. A Stop for one servo does not keep the others of its leg running.
    Deadlines come before a command of the same step: a command that was late does not save its leg.
    Every Stop is repeated, until its servo is started again.
    Legs at rest get Stops as well, since lost bytes may run a servo that nobody started (`Legs.stop_at_rest`): with a
    silent leg's Stop and the last one's, every 0.8 s while others run, and four times after the last Stop. None takes a
    rate slot or precedes a first Stop. No Stop that is owed moves to a later time.
 5. The emergency stop stops six legs and latches; `Reset` leaves the latch and nothing else. Each request is numbered,
    and a reset names the latest number, so that no reset that was sent before an emergency stop leaves it.
    What an earlier run has left engaged is engaged; until that is known (`EstopKept`), it counts as engaged.
 6. After `BusFailed` nothing is sent and everything is rejected until `BusOpened`; what waited is dropped.
    The latch of an emergency stop stays through it.
 7. `ShutDown` stops six legs and rejects everything from then on, except an emergency stop. A bus that answers again
    only then gets its Stops too.

 9. While somebody holds the lease, what moves and resets needs its token (`lease`). To take the lease from its
    holder stops six legs first, and what waited of others when somebody acquires it is dropped. Stops need no token.
10. Angles here are users'; only a frame that goes out has the servo's own (`Legs`, by the calibration in force). The
    calibration changes for no servo that runs or waits to be started, and nothing starts one meanwhile (`calibrating`).
11. A servo whose speed is limited goes towards its target step by step, one in each rate slot (`speed`, `Legs`).
12. Where a landing is configured, a silent leg begins one in place of its Stop: all servos that run go to the landing
    pose, nothing else moves, and six legs are stopped at an end that is known from its beginning (`landing`).
14. While fewer buttons are alive than are required, starts, sets and resets are rejected, and what runs is stopped, or
    lands, when they have become too few (`buttons`). Stops need no button.
15. Where a limit is set, nothing starts on a low battery, and nothing moves once the body has been tilted for too long:
    what runs is then stopped, or lands (`body_limits`).
16. Where the wire can start and stop the whole robot only, all servos run or wait to be started, or none does: a start
    names all of them, and leaves with the last leg's rate slot; whatever stops one of them stops all in the same step.
17. With a power board, a start waits until its servo is fed, and its leg's watchdog with it (`power`); what the board
    feeds no longer is stopped, and all that runs is stopped, or lands, when it does not answer.
19. A leg that does not run takes no start from a burst of messages without a time (`backlog`).
20. Under another source, and soon behind its Stop, a servo goes to its first target at a limited speed (`speed`).

`StoppedOutside` reports `stop-servos` at work on the same device. All legs count as stopped and get a Stop from here
too, since one may have been started after its Stop from outside. Until that program is known to have ended, no Start or
Set is taken: one of its Stops may still come, and would undo it unseen.

Within one instant, the order of what came by different channels is unknown. So a Stop wins over a Start or Set of
another channel, and the emergency stop wins over a reset.
"""

from collections.abc import Collection
from typing import Final, assert_never

from gateway.allowance import NS_PER_MS
from gateway.model.angle_limits import AngleLimits
from gateway.model.frames import OP_SET
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
    CalibrationSaved,
    Command,
    Completed,
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
    StoppedOutside,
    TimePassed,
    Transmit,
)
from gateway.robot.core.latch import Latch
from gateway.robot.core.lease import RobotLease
from gateway.robot.core.leg import Rules
from gateway.robot.core.legal import LEGAL, IllegalEvent
from gateway.robot.core.legs import Legs
from gateway.robot.core.power import LOST, SILENT, UNFED, PowerRule, servos_to_feed, unfed_since
from schemas.robot import LEGS
from schemas.telemetry import Cause, Kind, Mode, Reason

_ALL: Final = tuple(LEGS)
_ESTOPPED: Final = "the emergency stop is engaged; reset it first"
_BUS_FAULT: Final = "the SPI bus is at fault; the gateway is trying to open it again"
_STOPPING: Final = "the gateway is ending"
_OUTSIDE: Final = "stop-servos stops all servos past the gateway; start them once it has ended"
_LANDING: Final = "the robot lands; start it once all legs are stopped"
_REJECTING: Final = {
    Mode.ESTOPPED: (Reason.ESTOPPED, _ESTOPPED),
    Mode.BUS_FAULT: (Reason.BUS_FAULT, _BUS_FAULT),
    Mode.STOPPING: (Reason.STOPPING, _STOPPING),
}
"""The modes in which every command that comes is rejected, and why."""


class Supervisor:
    """Decides what reaches the robot. One owner, one thread."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._reach = AngleLimits(rules.joint_limits_cdeg, rules.landing_cdeg, rules.avoid_cdeg)
        self.calibrating, self.legs = Calibrating(self._reach), Legs(rules, self._reach)
        self.backlog = Backlog(rules, self.legs)
        self.lease, self.buttons = RobotLease(rules), Buttons(rules)
        self.body, self.power = BodyLimits(rules), PowerRule(rules)
        self.wants_measurements = self.body.watches
        """Whether `BodyMeasured` decides anything."""
        self._opened = False  # ever
        self._bus_ok = False
        self._fault = Kind.BUS_FAULT  # the one that was announced, while there is one
        self.latch = Latch(rules)
        self._ended = False
        self.stopped_outside = False
        """Whether `stop-servos` is known to be at work on the same device."""
        self.expirations = 0
        self.mode = Mode.STARTING
        """What the gateway as a whole is doing."""
        self.due_ns: int | None = None
        """When `TimePassed` is next needed; None: not before something else happens."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        """Take one event. Raises IllegalEvent, and changes nothing, where it has no place in this mode (`LEGAL`).
        Events with the same `instant_ns` (their own time, if not given) were collected together, in an unknown order.
        """
        if type(event) not in LEGAL[self.mode]:
            raise IllegalEvent(f"{type(event).__name__} while {self.mode}")
        if type(event) is CalibrationSaved and not self.calibrating.awaits(event.number):
            raise IllegalEvent(f"calibration {event.number} is not on its way to the disk")
        if type(event) is EstopKept and not self.latch.unknown:
            raise IllegalEvent("what an earlier run has left of its emergency stops is known")
        self.legs.begin(now_ns if instant_ns is None else instant_ns)
        lease_ns, button_ns = self.lease.due_ns, self.buttons.due_ns
        late = (lease_ns is not None and now_ns >= lease_ns) or (button_ns is not None and now_ns >= button_ns)
        effects = [*self.lease.expire(now_ns), *self.buttons.expire(now_ns, self._then())] if late else []
        # An event takes its place between the deadlines that it is too late for and the rate slots that it may use.
        due = self._bus_ok and self.due_ns is not None and now_ns >= self.due_ns
        if (due or self.buttons.closed) and self._stops_all(event):
            due = False
        elif self.buttons.closed:
            effects += self._stop_unwatched(now_ns)
        if due:
            effects += self._expire(now_ns)
        effects += self._take(event, now_ns)
        if due:
            effects += self.legs.repeat_stops(now_ns)
            effects += self.legs.take_slots(now_ns)
            effects += self.legs.land(now_ns)
        if self._bus_ok:
            effects += self.legs.stop_at_rest(now_ns)
        self.legs.look(now_ns)
        if self.legs.landing is not None and self.legs.at_rest:
            self.legs.landing = None  # people have stopped all that was on its way down
        self.mode = self._mode_now()
        self.due_ns = self.legs.due_ns if self._bus_ok else None
        if self.lease.due_ns is not None:
            self.due_ns = self.lease.due_ns if self.due_ns is None else min(self.due_ns, self.lease.due_ns)
        if self.buttons.due_ns is not None:
            self.due_ns = self.buttons.due_ns if self.due_ns is None else min(self.due_ns, self.buttons.due_ns)
        return sorted(effects, key=_after_stops) if self.legs.given else effects

    def _take(self, event: Event, now_ns: int) -> list[Effect]:
        effects: list[Effect]
        match event:
            case Command():
                effects = self._command(event, now_ns)
            case TimePassed() | EstopKept():
                effects = self.latch.kept(event, self.legs.instant_ns) if isinstance(event, EstopKept) else []
            case EmergencyStop():
                effects = self._emergency_stop(event, now_ns)
            case Reset():
                effects = self._reset(event, now_ns)
            case LeaseRequest():
                effects = self._lease_request(event, now_ns)
            case StoppedOutside():
                effects = self._outside(event, now_ns)
            case ButtonRequest():
                effects = self._button_request(event, now_ns)
            case Calibrate() | CalibrationSaved():
                effects = self._calibration(event, now_ns)
            case BodyMeasured() | PowerSeen():
                effects = self._sensed(event, now_ns)
            case BusOpened() | BusFailed():
                effects = self._bus_opened(now_ns) if isinstance(event, BusOpened) else self._bus_failed(event)
            case ShutDown():
                effects = self._shut_down(now_ns)
            case _:
                assert_never(event)
        return effects

    def _stops_all(self, event: Event) -> bool:
        """Whether it stops everything, or finds a bus that sends nothing: what was due has no meaning any more."""
        if isinstance(event, LeaseRequest):
            return not self._ended and self.lease.is_takeover(event)
        if isinstance(event, StoppedOutside | PowerSeen):
            return event.at_work if isinstance(event, StoppedOutside) else bool(event.doubt) and not self._ended
        return isinstance(event, EmergencyStop | BusOpened | BusFailed | ShutDown)

    def _mode_now(self) -> Mode:
        """The first that applies."""
        if self._ended:
            return Mode.STOPPING
        if not self._bus_ok:
            return Mode.BUS_FAULT if self._opened else Mode.STARTING
        if self.latch.since_ns is not None or self.latch.unknown:
            return Mode.ESTOPPED
        return Mode.IDLE if self.legs.at_rest else Mode.ACTIVE

    # ---- events

    def _command(self, command: Command, now_ns: int) -> list[Effect]:
        rejected, dropped = command.rejected, list[Effect]()
        if rejected is None:
            dropped = self.backlog.note(command, now_ns)
            rejection = self._rejection(command) or self.backlog.rejection(command, now_ns)
            if rejection is None:
                if command.lease is not None:
                    self.lease.heard(command.lease, now_ns)
                self.backlog.hold(command, now_ns)
                effects = self.legs.apply(command, now_ns)
                return [*dropped, *effects, *self.legs.take_slots(now_ns)] if dropped else effects
            rejected = Rejected(command, *rejection)
        stops = self.legs.stop_for(command, rejected, now_ns, write=not self._ended) if self._bus_ok else [rejected]
        return [*dropped, *stops]

    def _rejection(self, command: Command) -> tuple[Reason, str] | None:
        """Why the command as a whole takes no effect; None: it does."""
        if self.mode in _REJECTING:
            return _REJECTING[self.mode]
        moves = command.moves
        guarded = self.stopped_outside or self.lease.guards or self.legs.landing is not None or self.calibrating.guards
        closed = self.buttons.closed or self.body.low or self.body.fallen or self.power.closed
        if moves and (guarded or closed or command.lease is not None):
            rejection = self._why_closed(command.lease)
            if rejection is None and closed:
                rejection = self.buttons.bar() or self.body.rejection(moves, self.legs.servos)
                rejection = rejection or self.power.rejection(moves)
            rejection = rejection or self.calibrating.rejection(moves)
            if rejection is not None:
                return rejection
        for servo_id, op in moves if self._reach.limited else ():
            why_not = self._reach.why_not(servo_id, op.angle_cdeg)
            if why_not is not None:
                return Reason.JOINT_LIMIT, why_not
        for servo_id, op in moves:
            servo = self.legs.servos[servo_id]
            if servo.stopped_ns == self.legs.instant_ns and not servo.stopped_by <= {command.channel}:
                # Which of the two is older is not known, and an older Start must not overtake a Stop.
                by = ", ".join(sorted(servo.stopped_by))
                return Reason.SERVO_STOPPED, f"servo {servo_id} was stopped in the same instant ({by})"
            if op.op is OP_SET and servo.angle_cdeg is None and not servo.will_run:
                return Reason.SERVO_STOPPED, f"servo {servo_id} does not run; start it before you set it"
        return self.legs.why_not_whole(command) if self._rules.starts_whole else None

    def _why_closed(self, lease: str | None) -> tuple[Reason, str] | None:
        """Why nothing may move now, whatever it is; None: it may."""
        if self.stopped_outside:
            return Reason.SERVO_STOPPED, _OUTSIDE
        rejection = self.lease.rejection(lease)
        if rejection is not None:
            return rejection
        return None if self.legs.landing is None else (Reason.LANDING, _LANDING)

    def _calibration(self, event: Calibrate | CalibrationSaved, now_ns: int) -> list[Effect]:
        return self.calibrating.kept(event) if isinstance(event, CalibrationSaved) else self._calibrate(event, now_ns)

    def _calibrate(self, event: Calibrate, now_ns: int) -> list[Effect]:
        rejection = _REJECTING.get(self.mode) or self._why_closed(event.lease)
        if rejection is not None:
            return [Rejected(event, *rejection)]
        effects = self.calibrating.change(event, self.legs.servos)
        if event.lease is not None and self.calibrating.awaits(event.number):
            self.lease.heard(event.lease, now_ns)
        return effects

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        latch, first = self.latch, self.latch.since_ns is None
        latch.number += 1
        latch.since_ns = self.legs.instant_ns  # not `now_ns`: a reset of the same instant may be the older of the two
        effects = self._stop_all(Cause.ESTOP, now_ns, Reason.ESTOPPED, _ESTOPPED)
        if first:
            detail = "emergency stop; all commands are rejected until a reset"
            if not self._bus_ok:
                detail += "; the SPI bus does not answer, and the Stop frames follow as soon as it does"
            effects.append(Announce(Kind.ESTOP_ENGAGED, detail, event.source, event.key))
        return effects

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        if self.mode in _REJECTING and self.mode is not Mode.ESTOPPED:
            return [Rejected(event, *_REJECTING[self.mode])]
        closed = self.lease.rejection(event.lease, reset=True) or self.buttons.bar()
        if closed is not None:
            return [Rejected(event, *closed)]
        why_not = self.latch.why_not_left(event.estop, self.legs.instant_ns)
        if why_not is not None:
            return [Rejected(event, Reason.ESTOPPED, why_not)]
        if event.lease is not None:
            self.lease.heard(event.lease, now_ns)
        if self.latch.since_ns is None:
            return [Completed(event)]
        self.latch.since_ns = None
        detail = "emergency stop left; nothing moves until it is started again"
        return [Announce(Kind.ESTOP_RESET, detail, event.source, event.key), Completed(event)]

    def _lease_request(self, request: LeaseRequest, now_ns: int) -> list[Effect]:
        if self._ended:
            return [RequestAnswer(Reason.STOPPING, _STOPPING)]
        before: list[Effect] = []
        if self.lease.is_takeover(request):
            before = self._stop_all(Cause.COMMAND, now_ns, Reason.NOT_HOLDER, f"{request.source} has taken the lease")
        published, answer = self.lease.grant(request, now_ns)
        if answer.token is not None:
            # What others had waiting would move under the new holder.
            detail = f"{self.lease.holder} has acquired the lease"
            before += self.legs.drop(self.legs.servos.values(), Reason.NOT_HOLDER, detail)
        return [*before, *published, answer]

    def _button_request(self, request: ButtonRequest, now_ns: int) -> list[Effect]:
        if self._ended:
            return [RequestAnswer(Reason.STOPPING, _STOPPING)]
        published, answer = self.buttons.grant(request, now_ns, self._then())
        return [*(self._stop_unwatched(now_ns) if self.buttons.closed else ()), *published, answer]

    def _outside(self, event: StoppedOutside, now_ns: int) -> list[Effect]:
        first, self.stopped_outside = event.at_work and not self.stopped_outside, event.at_work
        if not event.at_work:
            return []
        effects = self._stop_all(Cause.REPEAT, now_ns, Reason.SERVO_STOPPED, _OUTSIDE)
        if first:
            detail = "stop-servos stopped all servos past the gateway; nothing moves until it is started again"
            effects.append(Announce(Kind.STOPPED_OUTSIDE, detail))
        return effects

    def _bus_opened(self, now_ns: int) -> list[Effect]:
        recovered, self._opened, self._bus_ok = self._opened, True, True
        effects = self._stop_all(Cause.STARTUP, now_ns, Reason.BUS_FAULT, _BUS_FAULT)
        if recovered:
            of_bus, self._fault = self._fault is Kind.BUS_FAULT, Kind.BUS_FAULT
            who, kind = ("SPI bus", Kind.BUS_RECOVERED) if of_bus else ("controller", Kind.CONTROLLER_RETURNED)
            effects.append(Announce(kind, f"the {who} answers again; all servos are stopped"))
        return effects

    def _bus_failed(self, event: BusFailed) -> list[Effect]:
        first, self._bus_ok, self._opened = self._bus_ok or not self._opened, False, True
        # One that restarted and does not come back is silent, which a person has to see to.
        stays_away = event.kind is Kind.CONTROLLER_SILENT and self._fault is Kind.CONTROLLER_RESTARTED
        self.legs.landing = None  # the bus that opens again stops everything, and lands nothing
        effects = self.legs.lose_bus(Reason.BUS_FAULT, _BUS_FAULT)
        if first or stays_away:
            self._fault = event.kind
            effects.append(Announce(event.kind, event.detail))
        return effects

    def _shut_down(self, now_ns: int) -> list[Effect]:
        self._ended = True
        self.legs.rest.runs = 0
        self.lease.end()
        stopped = "all servos are stopped" if self._bus_ok else "the SPI bus does not answer, so no Stop can be sent"
        announcement = Announce(Kind.STOPPING, f"the gateway ends; {stopped}")
        return [*self._stop_all(Cause.SHUTDOWN, now_ns, Reason.STOPPING, _STOPPING), announcement]

    # ---- Stops for the gateway's own reasons

    def _stop_unwatched(self, now_ns: int) -> list[Effect]:
        if self._nothing_to_stop():
            return []
        fell_ns = now_ns if self.buttons.fell_ns is None else self.buttons.fell_ns
        return self._bring_down("too few buttons are alive", fell_ns, now_ns, *self.buttons.rejection())

    def _sensed(self, event: BodyMeasured | PowerSeen, now_ns: int) -> list[Effect]:
        if isinstance(event, PowerSeen):
            return self._power_seen(event, now_ns)
        published = self.body.note(event, now_ns, self._then())
        if not self.body.fallen or self._nothing_to_stop():
            return published
        down = self._bring_down("the body is tilted", self.body.fell_ns, now_ns, *self.body.has_fallen())
        return [*down, *published]

    def _power_seen(self, event: PowerSeen, now_ns: int) -> list[Effect]:
        self.power.note(event)
        self.legs.note_fed(event.fed)
        if not self._bus_ok or self._ended:
            return []
        if event.doubt:
            return self._stop_all(Cause.WATCHDOG, now_ns, Reason.NO_POWER, event.doubt)
        if not event.alive:
            return [] if self._nothing_to_stop() else self._bring_down(SILENT, now_ns, now_ns, Reason.NO_POWER, SILENT)
        lost = {each // 10 for each in (*event.lost, *dict(event.refused)) if self.legs.servos[each].will_run}
        return [*self._stop_unfed(lost, LOST, now_ns), *self.legs.start_fed(now_ns)]

    def to_feed(self) -> dict[int, int | None]:
        """See `servos_to_feed`; nothing is fed while the bus is at fault."""
        return servos_to_feed(self.legs.servos.values(), self._reach.wire) if self._bus_ok else {}

    def _stop_unfed(self, legs: Collection[int], detail: str, now_ns: int) -> list[Effect]:
        due = dict.fromkeys(self.legs.by_number if legs and self._rules.stops_whole else sorted(legs))
        return self.legs.stop(due, Cause.WATCHDOG, now_ns, Reason.NO_POWER, detail) if due else []

    def _bring_down(self, why: str, since_ns: int, now_ns: int, reason: Reason, detail: str) -> list[Effect]:
        """The robot lands, if something runs and there is time left; else all six legs are stopped."""
        ends_ns = since_ns + self._rules.landing_ns
        if now_ns < ends_ns and self.legs.running:
            return self._begin_landing(why, ends_ns, now_ns)
        due = dict.fromkeys(self.legs.by_number, since_ns)
        return self.legs.stop(due, Cause.WATCHDOG, now_ns, reason, detail)

    def _then(self) -> str:
        """What an event says if the robot is brought down in this step; "": nothing is to be stopped."""
        if self._nothing_to_stop():
            return ""
        lands = self._rules.landing_ns and self.legs.running
        return "the robot lands" if lands else "all six legs are stopped"

    def _nothing_to_stop(self) -> bool:
        return not self._bus_ok or self.legs.landing is not None or not any(leg.armed for leg in self.legs)

    def _expire(self, now_ns: int) -> list[Effect]:
        if self.legs.landing is not None:
            return self._touch_down(self.legs.landing.ends_ns, now_ns)
        unfed = unfed_since(self.legs, now_ns - self._rules.feed_ns)
        return [*self._stop_unfed(unfed, UNFED, now_ns), *self._expire_silent(now_ns)]

    def _expire_silent(self, now_ns: int) -> list[Effect]:
        deadlines = {
            leg.number: deadline
            for leg in self.legs
            if (deadline := leg.deadline_ns(self._rules.timeout_ns)) is not None
        }
        silent = {number: deadline for number, deadline in deadlines.items() if now_ns >= deadline}
        if not silent:
            return []
        self.expirations += len(silent)
        timeout_ms = self._rules.timeout_ns / NS_PER_MS
        first = min(silent.values())
        ends_ns = first + self._rules.landing_ns
        if now_ns < ends_ns and self.legs.running:
            why = f"leg {min(silent)} was not heard for {timeout_ms:g} ms"
            return self._begin_landing(why, ends_ns, now_ns)
        due = {leg.number: silent.get(leg.number, first) for leg in self.legs} if self._rules.stops_whole else silent
        expired = [leg for leg in self.legs if leg.number in due and leg.armed]
        detail = "the command was pending longer than the watchdog allows"
        effects = self.legs.stop(due, Cause.WATCHDOG, now_ns, Reason.STALE, detail)
        for leg in expired:
            leg.expired = True
        whole = "; all six legs are stopped" if self._rules.stops_whole else "; it is stopped"
        whole += ", since this robot can only be stopped as a whole" if self._rules.starts_whole else ""
        for number in silent:
            detail = f"leg {number} was not heard for {timeout_ms:g} ms{whole}"
            stopped = _ALL if self._rules.stops_whole else (number,)
            effects.append(Announce(Kind.WATCHDOG_EXPIRED, detail, legs=stopped))
        return effects

    def _begin_landing(self, why: str, ends_ns: int, now_ns: int) -> list[Effect]:
        """A leg or a button fell silent, or the body is tilted: the whole robot goes down, also legs still commanded.
        On five legs, one limp, it would fall. Nothing can make the landing longer: neither a link that comes back (what
        comes is rejected) nor a second leg's silence (whose own Stop would come later than this one).
        """
        dropped = self.legs.begin_landing(now_ns, ends_ns, self._reach.landing_cdeg())
        landing_ms = self._rules.landing_ns / NS_PER_MS
        detail = f"{why}; the robot lands, and is stopped {landing_ms:g} ms later"
        return [*dropped, Announce(Kind.LANDING, detail, legs=_ALL)]

    def _touch_down(self, ends_ns: int, now_ns: int) -> list[Effect]:
        if now_ns < ends_ns:
            return []
        moved = [leg for leg in self.legs if leg.armed]
        self.legs.landing = None
        effects = self.legs.stop(
            dict.fromkeys(self.legs.by_number, ends_ns), Cause.WATCHDOG, now_ns, Reason.LANDING, _LANDING
        )
        for leg in moved:
            leg.expired = True
        detail = "the robot has landed; all six legs are stopped"
        return [*effects, Announce(Kind.WATCHDOG_EXPIRED, detail, legs=_ALL)]

    def _stop_all(self, cause: Cause, now_ns: int, reason: Reason, detail: str) -> list[Effect]:
        self.legs.landing = None  # a Stop of all legs ends a landing
        if not self._bus_ok:
            return self.legs.drop(self.legs.servos.values(), reason, detail)
        return self.legs.stop({leg.number: None for leg in self.legs}, cause, now_ns, reason, detail)


def _after_stops(effect: Effect) -> bool:
    """Sorts Stops to the front: no frame that moves, and no answer to anyone, stands before one."""
    return not (isinstance(effect, Transmit) and effect.frame.is_stop)
