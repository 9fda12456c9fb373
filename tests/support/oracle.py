"""Judges every step of a supervisor by the contract's words, from outside: events, frames and answers are all it sees.

It keeps a history of its own (who was heard when, which servos the frames have energised, which Stops are still to be
repeated, which commands wait for an answer), says beforehand what must happen, and raises `Violation` where something
else does. It shares no state and no rules with `gateway/robot/core`, only the vocabulary.
"""

from collections.abc import Sequence

from gateway.model.frames import STOP, Op, servo_ids_of, stop_leg
from gateway.robot.core.events import (
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
    Reset,
    SaveCalibration,
    ShutDown,
    StoppedOutside,
    TimePassed,
    Transmit,
)
from gateway.robot.core.supervisor import Supervisor
from schemas.words import Cause, Kind, Reason
from tests.support.history import (
    CLOSED,
    LandingHistory,
    announced,
    change_hands,
    demand,
    is_announced,
    is_coalesced,
    is_newer,
    judge_halts,
    judge_results,
    rejections_of,
    stepped,
    stopped_by,
    supply_of,
)
from tests.support.robot_history import RobotHistory


class Oracle(RobotHistory):
    """The history of one robot, and the judge of its next step."""

    def judge(
        self, event: Event, now_ns: int, effects: Sequence[Effect], after: Supervisor, instant_ns: int | None = None
    ) -> None:
        """Judge one step by its event, its effects, and the supervisor after it. Raise Violation.

        The event belongs to the instant that began at `instant_ns`, or to one of its own.
        """
        self.instant_ns = now_ns if instant_ns is None else instant_ns
        self._pose_cdeg = self.calibration.landing_cdeg()  # a deadline comes before what the step takes
        kept = self.calibration.kept(event, effects, self.alive) if isinstance(event, CalibrationSaved) else None
        judge_results(effects)
        effects = self.calibration.read(effects)
        self._lost = frozenset()
        halted, lived = announced(effects, {Kind.LEGS_STOPPED}), self.alive
        rejected = {each for effect in effects if isinstance(effect, Rejected) for each in effect.request.servo_ids}
        stops_end = lived - (rejected - self.energised)  # a start may end with its command, before a Stop
        step, supply = effects, supply_of(effects)
        effects = [each for each in effects if each not in halted and each not in supply]
        ran = bool(self.energised)
        due = any(servo.owed and now_ns >= servo.owed_ns for servo in self.servos.values())
        self.owing, self.sent_again, self.put_off, self.together = [], [], False, due and not ran
        stops = [isinstance(effect, Transmit) and effect.frame.is_stop for effect in effects]
        demand(stops == sorted(stops, reverse=True), "in every step, all Stops come before anything else")
        self.lease.pass_time(now_ns, effects)
        self.buttons.pass_time(now_ns, effects)
        self.body.judge(event if isinstance(event, BodyMeasured) else None, now_ns, effects)
        doubted = isinstance(event, PowerSeen) and self.power.doubts(event)
        self.power.take(event)
        match event:
            case PowerSeen() if doubted and self.bus_ok and not self.ended:
                self._all_stopped(effects, Cause.WATCHDOG, Reason.NO_POWER, now_ns)
            case Command() | Reset() | TimePassed() | Calibrate() | ButtonRequest() | BodyMeasured() | PowerSeen():
                self._in_time(event, now_ns, effects)
            case CalibrationSaved():
                self._must_be_rejected(event, effects, kept)
                self._in_time(event, now_ns, effects)
                self.forget_angles(changed=kept is None)
            case LeaseRequest() if self.lease.judge(event, now_ns, effects, ended=self.ended):
                self._all_stopped(effects, Cause.COMMAND, Reason.NOT_HOLDER, now_ns)
            case LeaseRequest():
                self._in_time(event, now_ns, effects)
                demand(not self.lease.is_new or not self.pending, "what waited of others moves under no new holder")
                for servo in self.servos.values() if self.lease.is_new else ():
                    servo.bound_cdeg = None
            case EmergencyStop():
                engaged, self.latched_ns = self.latched_ns is not None, self.instant_ns
                self.estops += 1
                self._all_stopped(effects, Cause.ESTOP, Reason.ESTOPPED, now_ns)
                demand(is_announced(effects, Kind.ESTOP_ENGAGED) != engaged, "an emergency stop is announced once")
            case EstopKept() | StoppedOutside(at_work=False):
                self.learn(event)
                self._in_time(event, now_ns, effects)
            case StoppedOutside():
                known, self.outside = self.outside, True
                self._all_stopped(effects, Cause.REPEAT, Reason.SERVO_STOPPED, now_ns)
                demand(is_announced(effects, Kind.STOPPED_OUTSIDE) != known, "Stops from outside are announced once")
            case BusOpened():
                back = Kind.BUS_RECOVERED if self.fault is Kind.BUS_FAULT else Kind.CONTROLLER_RETURNED
                demand(is_announced(effects, back) == self.opened, "that the bus is back is announced as its fault was")
                self.fault = Kind.BUS_FAULT
                self.opened = self.bus_ok = True
                self._all_stopped(effects, Cause.STARTUP, Reason.BUS_FAULT, now_ns)
                self.forget_angles(changed=True)
            case ShutDown():
                self.ended = True
                self.lease.end()
                self._all_stopped(effects, Cause.SHUTDOWN, Reason.STOPPING, now_ns)
            case BusFailed():
                first = self.bus_ok or not self.opened
                stays_away = (self.fault, event.kind) == (Kind.CONTROLLER_RESTARTED, Kind.CONTROLLER_SILENT)
                news = first or stays_away
                self.fault = event.kind if news else self.fault
                demand(is_announced(effects, event.kind) == news, "a fault of the bus is announced once")
                self.opened, self.bus_ok, self.rest_ns, self.runs_left = True, False, None, 0
                self._all_stopped(effects, Cause.COMMAND, Reason.BUS_FAULT, now_ns)
        keeps = any(isinstance(effect, SaveCalibration) for effect in effects)
        demand(isinstance(event, Calibrate) or not keeps, "only a change of the calibration is kept")
        calibrated = is_announced(effects, Kind.CALIBRATED)
        demand(isinstance(event, CalibrationSaved) or not calibrated, "a calibration is in force once it is kept")
        demand(after.mode is self.mode, f"the mode is {self.mode}, not {after.mode}")
        demand(
            after.latch.number == self.estops, f"{self.estops} emergency stops were requested, not {after.latch.number}"
        )
        holder, alive = after.lease.holder, after.buttons.alive
        to_feed, fed = self.to_feed(), after.legs.to_feed()
        demand(fed == to_feed, f"the board is to feed {to_feed}, not {fed}")
        reset = isinstance(event, Reset) and not rejections_of(event.number, effects)
        self.power.judge(step, to_feed, self.mode, self.estops, reset=reset, outside=self.outside)
        demand(holder == self.lease.holder, f"{self.lease.holder} holds the lease, not {holder}")
        demand(alive == self.buttons.alive, f"{self.buttons.alive} are alive, not {alive}")
        self._after(now_ns, after.due_ns, ran=ran)
        judge_halts(effects, halted, stops_end, lived - self.alive)

    def _all_stopped(self, effects: Sequence[Effect], cause: Cause, reason: Reason, now_ns: int) -> None:
        frames = [(effect.frame, effect.cause) for effect in effects if isinstance(effect, Transmit)]
        expected = [(stop_leg(leg), cause) for leg in self.legs] if self.bus_ok else []
        demand(frames == expected, f"{cause}: a Stop to each leg and nothing else; nothing to a bus at fault")
        self.landing, self.put_off = None, True
        if self.energised or (self.rest_ns is not None and now_ns >= self.rest_ns):
            self.rest_ns = None  # these Stops are the ones for legs at rest
        for servo in self.servos.values():
            servo.want = servo.bound_cdeg = None
            if self.bus_ok:
                servo.rest(now_ns)
                servo.stop(cause, self.instant_ns)
                self.owe((servo,), now_ns)
            else:
                servo.owed = 0  # a bus that opens again gets a Stop for every leg
        for leg in self.legs.values():
            leg.source = None if self.bus_ok else leg.source
        for effect in effects:
            if isinstance(effect, Completed | Rejected):
                demand(isinstance(effect, Rejected) and effect.reason is reason, f"what waited is rejected: {reason}")
                self._answered(effect.request.number)
        demand(not self.pending, "nothing waits any more")

    def _in_time(self, event: Event, now_ns: int, effects: Sequence[Effect]) -> None:
        frames = [effect for effect in effects if isinstance(effect, Transmit)]
        if not self.bus_ok:
            demand(not frames, "nothing is sent while the bus is at fault")
        ran = bool(self.energised)
        watchdog = self._unwatched(now_ns) + self._expired(now_ns)
        self.judge_starts(now_ns)
        if isinstance(event, ButtonRequest):
            self.buttons.judge(event, now_ns, effects, ended=self.ended)
            watchdog += self._unwatched(now_ns)
        watchdog += self._fallen(now_ns)
        watchdog += self._unfed(event, now_ns)
        expired = [effect.frame for effect in frames if effect.cause is Cause.WATCHDOG and effect.frame.is_stop]
        demand(
            expired == [stop_leg(leg) for leg in watchdog],
            f"legs not heard for the timeout, and those that too few buttons watch, are stopped: {watchdog}",
        )
        stops: frozenset[int] = frozenset()
        if isinstance(event, Command):
            stops = self._command(event, now_ns, effects)
        elif isinstance(event, Reset):
            self._reset(event, effects, now_ns)
        elif isinstance(event, Calibrate):
            self._calibrate(event, effects, now_ns)
        unowed: list[Transmit] = []
        for effect in effects:
            match effect:
                case Transmit(cause=Cause.COMMAND):
                    self.named(effect, event.number if isinstance(event, Command) else 0)
                    self._moved(effect, stops, now_ns)
                case Transmit(cause=Cause.REPEAT):
                    unowed += self.repeated(effect, now_ns)
                case Transmit():
                    self._unasked(effect, now_ns)
                case Completed() | Rejected():
                    self._answers(effect)
        if self.bus_ok:
            self.rest(effects, unowed, now_ns, ran=ran, silent=bool(watchdog))
        only_stops = isinstance(event, Command) and (not event.moves or bool(rejections_of(event.number, effects)))
        if self.rules.start_pause_ns and ((stops and only_stops) or watchdog):
            self.queue_ended(event)

    def _expired(self, now_ns: int) -> list[int]:
        """Stop the legs that the watchdog must stop now, before anything else, and return them."""
        if not self.bus_ok:
            return []
        waited_ns = {number: now_ns - leg.unfed_ns for number, leg in self.legs.items() if leg.unfed_ns is not None}
        unfed = [number for number, for_ns in waited_ns.items() if for_ns >= self.rules.feed_ns]
        if unfed:
            unfed = list(self.legs) if self.rules.whole_robot else unfed
            self._stopped_unasked(unfed, now_ns)
            self._lose(set())
        return unfed + self._silent_legs(now_ns)

    def _silent_legs(self, now_ns: int) -> list[int]:
        """Stop the legs that had no command within the timeout, and return them."""
        silent = [
            number
            for number, leg in self.legs.items()
            if self.armed(number)
            and (leg.unfed_ns is None or self.runs(number))
            and (leg.commanded_ns is None or now_ns - leg.commanded_ns >= self.rules.timeout_ns)
        ]
        stopped = list(self.legs) if silent and (self.rules.whole_robot or self.rules.starts_whole) else silent
        if self.landing is not None:
            stopped = list(self.legs) if now_ns >= self.landing.ends_ns else []
            self.landing = None if stopped else self.landing
        elif silent and self._lands(
            min(self.legs[number].commanded_ns or 0 for number in silent) + self.rules.timeout_ns, now_ns
        ):
            return []
        self._stopped_unasked(stopped, now_ns)
        return stopped

    def _unwatched(self, now_ns: int) -> list[int]:
        """Stop all legs if fewer buttons are alive than are required, and return them."""
        if not (self.bus_ok and self.buttons.closed and self.alive) or self.landing is not None:
            return []
        fell_ns = self.buttons.fell_ns
        demand(fell_ns is not None, "nothing ran before enough buttons were alive")
        return self._down(fell_ns or 0, now_ns)

    def _fallen(self, now_ns: int) -> list[int]:
        """Stop all legs if the body has fallen, and return them."""
        if not (self.bus_ok and self.body.fallen and self.alive) or self.landing is not None:
            return []
        return self._down((self.body.tilted_ns or 0) + self.rules.tilt_ns, now_ns)

    def _unfed(self, event: Event, now_ns: int) -> list[int]:
        """Stop the legs that the board does not feed, or all if it does not answer, and return them."""
        if not isinstance(event, PowerSeen) or not (self.bus_ok and self.alive):
            return []
        if not event.alive:
            return [] if self.landing is not None else self._down(now_ns, now_ns)
        waited = [number for number in self.legs if self.legs[number].unfed_ns is not None]
        unfed = sorted({servo_id // 10 for servo_id in self.alive & (event.lost | self.power.refused)})
        stopped = list(self.legs) if unfed and (self.rules.whole_robot or self.rules.starts_whole) else unfed
        self._stopped_unasked(stopped, now_ns)
        for number in waited:
            if not self.held(number) and not self.runs(number):
                self.legs[number].commanded_ns = now_ns  # its start leaves with the rate slot, watched from now on
        return stopped

    def _down(self, since_ns: int, now_ns: int) -> list[int]:
        """Stop all legs, unless the robot lands, and return them."""
        if self._lands(since_ns, now_ns):
            return []
        self._stopped_unasked(list(self.legs), now_ns)
        return list(self.legs)

    def _stopped_unasked(self, stopped: Sequence[int], now_ns: int) -> None:
        for number in stopped:
            self.legs[number].source = None
            for servo in self.servos_of(number):
                servo.rest(now_ns)
                if servo.want is not None:
                    self._lost |= {servo.want.number}
                servo.stop(Cause.WATCHDOG, self.instant_ns)
                self.owe((servo,), now_ns)
        if stopped and self.rules.start_pause_ns:
            # What waits to be energised is ended by the watchdog's Stop, before a command of the step.
            self._lose({each.want.number for each in self.servos.values() if each.want is not None and not each.on})

    def _lands(self, deadline_ns: int, now_ns: int) -> bool:
        """Begin a landing if something runs and time is left since the deadline. Return whether the robot lands."""
        ends_ns = deadline_ns + self.rules.landing_ns
        if not self.energised or now_ns >= ends_ns:
            return False
        ways = {}
        for servo_id, servo in self.servos.items():
            if servo.want is not None:
                self._lost |= {servo.want.number}
            servo.want, servo.bound_cdeg, servo.eases = None, None, False
            if servo.written_cdeg is not None:
                ways[servo_id] = servo.written_cdeg, self._pose_cdeg.get(servo_id, servo.written_cdeg)
        for leg in self.legs.values():
            leg.source = None
        self.landing = LandingHistory(now_ns, ends_ns, ways, {})
        return True

    def _unasked(self, transmit: Transmit, now_ns: int) -> None:
        """Judge a frame that nobody commanded: it must be the watchdog's."""
        demand(transmit.cause is Cause.WATCHDOG, f"a frame without a cause: {transmit.cause}")
        if transmit.frame.is_stop:
            return
        demand(self.landing is not None, "nothing moves unasked but a landing")
        self.legs[transmit.frame.leg].moved(now_ns, self.rules.period_ns)
        if self.landing is not None:
            self.landing.judge(transmit, self.servos, now_ns, self.rules, self.calibration.gap)

    def _command(self, command: Command, now_ns: int, effects: Sequence[Effect]) -> frozenset[int]:
        """Judge a command's verdict, and take its targets (its Stops, if it is rejected). Return the stopped servos."""
        self.backlog.comes(command, self.instant_ns, now_ns)
        reason, targets = self.reason_to_reject(command), command.targets
        reason = reason if command.rejected is None else command.rejected.reason
        named = tuple(target for target in targets if target[1].op is Op.STOP)
        mixed = reason is None and self.rules.starts_whole and 0 < len(named) < len(targets)
        self._must_be_rejected(command, effects, Reason.WHOLE_ROBOT if mixed else reason)
        if reason is not None or mixed:
            stopped = [
                effect.request.stopped
                for effect in effects
                if isinstance(effect, Rejected)
                if effect.request.number == command.number
            ]
            expected = [tuple(servo_id for servo_id, _ in named) if self.bus_ok else ()]
            demand(stopped == expected, f"a rejected command stops what it names: {expected}, not {stopped}")
        if reason is not None:
            targets = named if self.bus_ok and not self.ended else ()
            if not targets:
                return frozenset()
        else:
            self.lease.record_use(command.lease, now_ns)
            self.hold_starts(command, now_ns)
        if self.rules.starts_whole and named:
            targets = tuple((servo_id, STOP) for servo_id in self.servos)
        running = [number for number in self.legs if self.armed(number)]
        change_hands(self.legs, running, command, targets, effects)
        told_to_stop = stopped_by(effects)
        for servo_id, op in targets:
            servo = self.servos[servo_id]
            if op.op is not Op.STOP:
                self.legs[servo_id // 10].commanded_ns = now_ns
            if servo.want is not None:
                self.pending[servo.want.number] = True
            if op.op is Op.STOP:
                repeated_anyway = not servo.on and servo.owed > 0
                demand(servo_id in told_to_stop or repeated_anyway, f"the Stop for {servo_id} is sent at once")
                servo.stop(command.channel, self.instant_ns)
            else:
                servo.wants(command, op, self.legs[servo_id // 10].moved_ns, now_ns, self.rules)
        return frozenset(servo_id for servo_id, op in targets if op.op is Op.STOP)

    def _must_be_rejected(
        self, event: Command | Reset | Calibrate | CalibrationSaved, effects: Sequence[Effect], reason: Reason | None
    ) -> None:
        """Demand that a request is rejected for this reason, or that it is not (None)."""
        reasons = rejections_of(event.number, effects)
        name = "" if isinstance(event, Command) else f"a {type(event).__name__.lower()} "
        demand(reasons == ([] if reason is None else [reason]), f"{name}rejected for {reason}, not for {reasons}")
        self.pending[event.number] = False

    def _calibrate(self, event: Calibrate, effects: Sequence[Effect], now_ns: int) -> None:
        """Judge a change of the calibration: if it is accepted, it is kept, and answered once that is done."""
        closed = CLOSED.get(self.mode) or self.reason_to_move_nothing(event.lease)
        reason = self.calibration.calibrate(event, effects, closed, self.alive)
        self._must_be_rejected(event, effects, reason)
        if reason is None:
            del self.pending[event.number]
            self.lease.record_use(event.lease, now_ns)

    def _reset(self, reset: Reset, effects: Sequence[Effect], now_ns: int) -> None:
        reason = CLOSED.get(self.mode)
        if reason in (None, Reason.ESTOPPED):
            reason = self.lease.reason_to_reject(reset.lease, reset=True) or self.too_few_buttons or reason
        if reason is Reason.ESTOPPED and self.latched_ns is not None and not self.unknown:
            age_ns = self.instant_ns - self.latched_ns
            reason = None if is_newer(reset, age_ns, self.estops, self.rules) else reason
        self._must_be_rejected(reset, effects, reason)
        if reason is None:
            self.latched_ns = None
            self.lease.record_use(reset.lease, now_ns)

    # ---- frames

    def _moved(self, transmit: Transmit, stops: frozenset[int], now_ns: int) -> None:
        """Judge a frame that a command caused: each servo is sent its target, or its present operation again."""
        leg_number = transmit.frame.leg
        leg = self.legs[leg_number]
        if not transmit.frame.is_stop:
            demand(
                not (self.ended or self.latched_ns or self.unknown),
                "nothing moves after an emergency stop or at the end",
            )
            leg.moved(now_ns, self.rules.period_ns)
        ready = self.ungated(leg_number)
        staggered = self.rules.start_pause_ns > 0 and not transmit.frame.is_stop  # it repeats that a servo is off
        for servo_id, op in transmit.frame.servos:
            servo = self.servos[servo_id]
            if op.op is Op.STOP:
                ends = servo_id in stops and transmit.frame.is_stop
                demand(
                    ends or not servo.on, f"{servo_id} is stopped though nobody asked, or in a frame that moves others"
                )
                demand(
                    servo.want is None or servo_id not in ready or (staggered and not servo.on),
                    f"{servo_id} is stopped although a newer command wants it to move",
                )
                servo.rest(now_ns)
                if ends:
                    self.owe((servo,), now_ns)
                continue
            demand(servo_id in ready, f"{servo_id} is started before its power and its messages allow it")
            demand(servo.on or op.op is Op.START, f"{servo_id} is set although it does not run")
            if servo.want is None and servo.bound_cdeg is None:
                demand(op.op is Op.SET and op.angle_cdeg == servo.written_cdeg, f"nobody asked for {op} of {servo_id}")
            else:
                wanted, target = (Op.SET, servo.bound_cdeg or 0) if servo.want is None else servo.want[:2]
                servo.bound_for = servo.bound_for if servo.want is None else servo.want.number
                demand(op.op is wanted, f"{servo_id}: the newest target is sent")
                stepped(servo, servo_id, op.angle_cdeg, target, now_ns, self.rules, self.calibration.gap)
            if not servo.on:
                self.energise(leg_number, now_ns)
            servo.written_cdeg, servo.want, servo.owed, servo.said_ns = op.angle_cdeg, None, 0, now_ns

    # ---- answers, and what holds after every step

    def _answered(self, number: int) -> bool:
        demand(number in self.pending, f"command {number} is answered exactly once")
        return self.pending.pop(number)

    def _answers(self, effect: Completed | Rejected) -> None:
        replaced = self._answered(effect.request.number)
        waits = [servo for servo in self.servos.values() if servo.want and servo.want.number == effect.request.number]
        late = isinstance(effect, Rejected) and effect.reason is Reason.STALE
        own = isinstance(effect.request, Command) and effect.request.rejected is None
        demand(not (late and own) or effect.request.number in self._lost, "nothing is late but what came in clumps")
        if isinstance(effect, Completed):
            demand(effect.request.number not in self._lost, "what the watchdog dropped is rejected")
            demand(not waits, "an answer comes after the frames")
            demand(replaced == is_coalesced(effect.request), "replaced commands are answered as such")
        for servo in waits:
            servo.want = None  # a rejected command takes no effect any more
        for servo in self.servos.values() if isinstance(effect, Rejected) else ():
            if servo.bound_for == effect.request.number:
                servo.bound_cdeg = servo.edge_ns = None  # nor does a servo go on to where it has sent it

    def _after(self, now_ns: int, due_ns: int | None, *, ran: bool) -> None:
        waited_for = {servo.want.number for servo in self.servos.values() if servo.want is not None}
        if self.rules.starts_whole:
            states = self.energised, self.alive
            demand(all(len(each) in (0, len(self.servos)) for each in states), "the whole robot runs, or nothing of it")
        demand(waited_for == self.pending.keys(), f"every command is answered: {waited_for} wait, not {self.pending}")
        theirs = [each for each in (self.lease.due_ns, self.buttons.due_ns) if each is not None]
        if not self.bus_ok:
            theirs_ns = min(theirs, default=None)
            demand(due_ns == theirs_ns, "no time but the lease's and the buttons' is awaited while the bus is at fault")
            return
        latest = self.next_start(now_ns) + theirs
        self.landing = self.landing if self.energised else None
        latest += self.next_rest(now_ns, ran=ran)
        watched = not self.buttons.closed or self.landing is not None
        demand(watched or not self.alive, "nothing runs while fewer buttons are alive than are required")
        self.power.after(self.alive, lands=self.landing is not None)
        for number, leg in self.legs.items():
            servos = self.servos_of(number)
            if self.landing is not None:
                demand(now_ns < self.landing.ends_ns, "a landing ends in time")
                latest.append(self.landing.ends_ns)
            held = [each for each in self.held(number) if not self.gated(each)]
            leg.unfed_ns = (now_ns if leg.unfed_ns is None else leg.unfed_ns) if held else None
            if leg.unfed_ns is not None:
                demand(now_ns < leg.unfed_ns + self.rules.feed_ns, "a start that nobody feeds ends")
                latest.append(leg.unfed_ns + self.rules.feed_ns)
            if self.landing is None and self.armed(number) and (not held or self.runs(number)):
                deadline_ns = (leg.commanded_ns or 0) + self.rules.timeout_ns
                demand(now_ns < deadline_ns, "a leg without a command within the timeout is off")
                latest.append(deadline_ns)
            waits = [self.servos[each] for each in self.ungated(number)]
            looks = [self.backlog.verdict(each, now_ns) for each in servo_ids_of(number) if self.gated(each)]
            latest += [now_ns + 1 if isinstance(each, bool) else each for each in looks]  # judged in time: at once
            under_way = any(servo.want is not None or servo.bound_cdeg is not None for servo in waits)
            if under_way and not self.rules.start_pause_ns:
                together = self.legs.values() if self.rules.starts_whole and not self.energised else (leg,)
                slot_ns = max(each.slot_ns(self.rules.period_ns) for each in together)
                demand(now_ns < slot_ns, "what is pending is sent when the rate slot comes")
                latest.append(slot_ns)
            for servo in servos:
                if servo.owed:
                    demand(now_ns < servo.owed_ns or self.put_off, "a Stop is repeated in time")
                    latest.append(servo.owed_ns)
        in_time = due_ns is None if not latest else due_ns is not None and due_ns <= min(latest)
        demand(in_time, f"wakes up in time, if for anything: {due_ns}, not {latest}")
