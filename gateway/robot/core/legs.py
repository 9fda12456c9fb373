"""Makes frames from the legs' commands. Pure: time is an argument.

The supervisor decides whether a command is carried out. This module decides how: which targets wait for their leg's
rate slot, what a frame contains for three servos, which Stops are repeated, and when commands are done.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Final

from gateway.model.angle_limits import AngleLimits
from gateway.model.frames import OP_SET, OP_START, OP_STOP, SETS, STARTS, STOP, ServoOp, stop_leg
from gateway.robot.core.events import Command, Completed, Effect, Rejected, Targets, Transmit
from gateway.robot.core.landing import Landing
from gateway.robot.core.leg import (
    NEVER,
    Leg,
    RateSlots,
    Rules,
    Servo,
    StartQueue,
    frame_of,
    servos_of,
    stops,
    taken_over,
    withdrawn,
)
from gateway.robot.core.rest import RestStops
from gateway.robot.core.speed import LimitedSpeeds
from schemas.keys import LEGS_COMMAND
from schemas.robot import LEGS
from schemas.telemetry import Cause, Reason

_LOST: Final = "messages of the same key were lost, and a stop may be among them"
_PARTLY: Final = (
    "this robot can only be started as a whole: send one command with a start for each joint of all six legs to "
    f"{LEGS_COMMAND}"
)
_MIXED: Final = "this robot only stops as a whole: a Stop in this command stopped it, and its moves are dropped"


class Legs:
    """The six legs, and the pending commands of each."""

    # mutants accepted (FalseWithTrue, Forget, Step, TrueWithFalse): set before it is read
    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.limits = AngleLimits(rules.joint_limits_cdeg, rules.landing_cdeg, rules.avoid_cdeg)
        self._speeds = LimitedSpeeds(rules, self.limits)
        self.by_number = {number: Leg(number, servos_of(number), RateSlots(rules.period_ns)) for number in LEGS}
        self._all = tuple(self.by_number.values())
        self.servos = {servo.servo_id: servo for leg in self._all for servo in leg.servos}
        self.sends = False
        """Whether the bus is open and not at fault."""
        self.rest = RestStops(rules)
        self._queue = StartQueue(rules.start_pause_ns)
        self.landing: Landing | None = None
        self.fed: frozenset[int] | None = frozenset() if rules.power else None
        """Servos that the power board has confirmed to power, as of its latest news; None: there is no board."""
        self.land_ns = 0
        """When the landing's next frames are due: one for each leg in a period, at any speed."""
        self.at_rest = True
        """Whether no servo of any leg runs; as of the last `plan`."""
        self.begin(0)
        self.plan(0)

    def __iter__(self) -> Iterator[Leg]:
        return iter(self._all)

    @property
    def running(self) -> bool:
        """Whether a servo runs now, even within a step."""
        return {servo.angle_cdeg for servo in self.servos.values()} != {None}

    # ---- time

    def begin(self, instant_ns: int) -> None:
        """Begin a step of this instant (ns)."""
        self.instant_ns = instant_ns
        """When the present instant began; see `Supervisor.step`."""
        if self.fed:  # stopped servos have lost their power
            self.fed = frozenset([each for each in self.fed if each in self.servos and self.servos[each].will_run])
        self.stopping: set[int] = set()
        """The servos that get a Stop in this step."""
        self._first_stops: set[int] = set()
        """The servos that get a first Stop in this step."""
        self._silent = False
        """Whether the watchdog stops a leg in this step."""

    def plan(self, now_ns: int) -> None:  # mutants accepted (Forget, Lt_LtE): equal times; each step sets it anew
        """End a step: compute what is due next, and whether anything runs."""
        due_ns = repeat_ns = NEVER
        at_rest, rests, held = True, False, () if self.fed is None else self._held()
        for leg in self._all:
            waits = holds = runs = armed = False
            for servo in leg.servos:
                if servo.angle_cdeg is not None:
                    runs = armed = True
                if servo.waiting is not None:
                    holds, waits = (True, waits) if servo in held else (holds, True)
                    armed = armed or servo.waiting.op is OP_START
                if servo.repeats_left and servo.repeat_ns < repeat_ns:
                    repeat_ns = servo.repeat_ns
            leg_ns = NEVER if leg.commanded_ns is None or not armed else leg.commanded_ns + self._rules.timeout_ns
            if holds:
                leg.unfed_ns = now_ns if leg.unfed_ns is None else leg.unfed_ns
                leg_ns = min(leg_ns if runs else NEVER, leg.unfed_ns + self._rules.feed_ns)
            else:
                leg.unfed_ns = None
            if self.landing is not None and runs:
                moves = self.landing.moves(leg.servos)  # one that has arrived waits for the end
                leg_ns = min(self.landing.ends_ns, max(self.land_ns, leg.slots.next_ns) if moves else NEVER)
            if waits:
                next_ns = self._slot_ns(leg) if self._rules.starts_whole else leg.slots.next_ns
                slot_ns = self._queue.due_ns(leg.number, next_ns)
                if slot_ns is not None and slot_ns < leg_ns:
                    leg_ns = slot_ns
            due_ns = leg_ns if leg_ns < due_ns else due_ns
            at_rest, rests = at_rest and not runs, rests or not armed
        if at_rest or self.at_rest or self.rest.due_ns is None:
            self.rest.plan(now_ns, at_rest=at_rest, stopped=bool(self._first_stops))
            self._first_stops = set()
        if rests and self.rest.due_ns is not None:
            repeat_ns = self.rest.due_ns if self.rest.due_ns < repeat_ns else repeat_ns
        due_ns = repeat_ns if repeat_ns < due_ns else due_ns
        self.due_ns = None if due_ns == NEVER else due_ns
        """When the next deadline, repeat or rate slot is due; as of the last `plan`, like the next."""
        self.repeat_ns = None if repeat_ns == NEVER else repeat_ns
        """When the next repeated Stop, or the next one for legs at rest, is due."""
        self.at_rest = at_rest

    def _slot_ns(self, leg: Leg) -> int:  # mutants accepted (Step): all servos are in one state
        """Return when the leg's next frame may leave.

        A robot that starts as a whole waits for the last leg's rate slot. Between two frames of its start, only some
        servos would run, and the wire has no such state.
        """
        if not leg.waits_to_start:
            return leg.slots.next_ns
        return max(each.slots.next_ns for each in self if not each.servos[0].running)

    def start_fed(self, now_ns: int) -> list[Effect]:
        """Return the starts that waited for power, within their legs' rate slots, and arm these legs' deadlines."""
        held = self._held()
        for leg in self:
            if leg.unfed_ns is not None and not leg.runs and not any(servo in held for servo in leg.servos):
                leg.commanded_ns = now_ns
        return self.take_slots(now_ns)

    def _held(self) -> Collection[Servo]:
        """Return the servos whose starts wait for power. A command starts all its servos at once, or none."""
        if self.fed is None:
            return ()
        starting = [servo for servo in self.servos.values() if servo.starts]
        unfed = {servo.waiting_for for servo in starting if servo.servo_id not in self.fed}
        return {servo for servo in starting if servo.waiting_for in unfed}

    def to_feed(self) -> dict[int, int | None]:
        """Return the servos to power: running ones (None), and waiting starts with their wire angle (0.01 degrees).

        Supply may start a servo at this angle, so it stays the same while the start waits. With the bus at fault, no
        servo is powered.
        """
        found: dict[int, int | None] = {}
        for servo_id, servo in self.servos.items() if self.sends else ():
            if servo.angle_cdeg is not None:
                found[servo_id] = None
            elif servo.waiting is not None:
                from_cdeg = servo.waiting.angle_cdeg if servo.from_cdeg is None else servo.from_cdeg
                found[servo_id] = self.limits.calibration.of(servo_id).wire_cdeg(from_cdeg)
        return found

    def repeat_stops(self, now_ns: int) -> list[Effect]:
        """Return the repeated Stops that are due. If nothing runs, all pending repeats leave together: one preamble."""
        owed = [servo for servo in self.servos.values() if servo.repeats_left]
        due = [servo for servo in owed if now_ns >= servo.repeat_ns]
        if due and self.at_rest:
            due = [servo for servo in owed if servo in due or servo.servo_id not in self._first_stops]
        for servo in due:
            servo.repeats_left -= servo.servo_id not in self.stopping  # after a first Stop of this step, all are left
            servo.repeat_ns = now_ns + self._rules.repeat_interval_ns
        self.stopping.update(servo.servo_id for servo in due)
        by_leg = ((leg, [servo for servo in leg.servos if servo in due]) for leg in self) if due else ()
        return [effect for leg, servos in by_leg for effect in stops(leg, servos, Cause.REPEAT)]

    def take_slots(self, now_ns: int) -> list[Effect]:
        """Return the frames of the legs whose rate slot has come."""
        return [effect for leg in self for effect in self._send(leg, now_ns)]

    def stop_at_rest(self, now_ns: int) -> list[Effect]:
        """Return Stops for legs at rest, since a servo may run without a start. Call it at the end of a step.

        A controller that lost bytes may take a frame, even a Stop, for a start. A leg with a Stop in this step, or with
        pending repeats, gets no other.
        """
        ran = not self.at_rest and bool(self.stopping)
        come_to_rest = ran and not self.running
        if come_to_rest and len(self._first_stops) == len(self.servos):
            self.rest.due_ns = None  # this step has stopped all six legs, so no leg needs another Stop
            return []
        at_once = come_to_rest or self._silent
        due = self.rest.due_ns is not None and now_ns >= self.rest.due_ns
        if due and self.at_rest:  # a start ends these runs
            due = not self.running
        resting = [leg for leg in self if not leg.armed] if at_once or due else []
        if not resting:
            return []
        singly = (due or not self.at_rest) and self.rest.take(now_ns, is_run=due and self.at_rest)
        effects = list[Effect]()
        for leg in resting:
            stopped = any(not servo.repeats_left and servo.servo_id not in self.stopping for servo in leg.servos)
            if stopped:  # lost bytes make no start of a frame for one servo
                effects += stops(leg, leg.servos, Cause.REPEAT, joins=at_once, singly=singly)
                self.stopping.update(servo.servo_id for servo in leg.servos)
            if come_to_rest or (stopped and at_once):
                for servo in leg.servos:
                    self._stopped(servo, now_ns)
        return effects

    # ---- commands

    def apply(self, command: Command, now_ns: int) -> list[Effect]:  # mutants accepted (Forget): only time is lost
        """Carry out an accepted command, and return its effects."""
        effects: list[Effect] = []
        stops: list[tuple[Leg, list[Servo]]] = []
        taken: list[Effect] = []
        moved: list[Leg] = []
        stops_some = len(command.moves) < len(command.targets)
        by_leg, whole = command.by_leg, self._rules.starts_whole and stops_some
        if whole:  # all servos get a Stop; the moves are never written, so a command with moves is not completed
            command.left += len(self.servos) - len(command.stops)
            by_leg = {leg.number: tuple((servo.servo_id, STOP) for servo in leg.servos) for leg in self}
        for number, targets in by_leg.items():
            leg, moves = self.by_number[number], targets
            if stops_some:
                moves = tuple([target for target in targets if target[1].op is not OP_STOP])
                if len(moves) < len(targets):
                    stops.append((leg, [self.servos[servo_id] for servo_id, op in targets if op.op is OP_STOP]))
            if command.lost:
                leg.source = None
            elif leg.source != command.source:
                taken += taken_over(leg, command.source, bool(moves))
            if moves:
                # A Stop does not count: it does not keep the leg's other servos running.
                leg.commanded_ns = now_ns
                effects += self._take(leg, moves, command, now_ns)
                moved.append(leg)
        for leg, servos in stops:
            effects += self._stop_on_command(leg, servos, command, now_ns, beside=leg in moved)
        for leg in self if stops else moved:  # only now is it known which starts have to wait for others
            effects += self._send(leg, now_ns)
        if whole and command.moves:
            effects.append(withdrawn(command, Reason.WHOLE_ROBOT, _MIXED))
        return effects + taken if taken else effects

    def stop_for(self, command: Command, rejected: Rejected, now_ns: int, *, write: bool) -> list[Effect]:
        """Carry out only the Stops of a rejected command. Not `write`: the Stops are already written."""
        if not command.stops:
            return [rejected]
        effects: list[Effect] = []
        if write:
            stops = replace(command, targets=command.stops)
            stops.left += 1  # so that it is never completed: it is rejected
            effects = self.apply(stops, now_ns)
        rejected.request.stopped = tuple(servo_id for servo_id, _ in command.stops)
        return [*effects, rejected]

    # mutants accepted (Step): all servos are in one state
    def why_not_whole(self, command: Command) -> tuple[Reason, str] | None:
        """Return why a robot that only starts as a whole rejects these starts, or None.

        All its servos are in one state, so one servo shows whether the robot runs. A command with a Stop stops it.
        """
        moves = command.moves
        if not moves or len(moves) < len(command.targets) or len(moves) == len(self.servos):
            return None
        return None if self.servos[moves[0][0]].will_run else (Reason.WHOLE_ROBOT, _PARTLY)

    def _stop_on_command(
        self, leg: Leg, servos: list[Servo], command: Command, now_ns: int, *, beside: bool
    ) -> list[Effect]:
        """Carry out a command's Stops for a leg: the frames leave now. `beside`: it moves other servos of the leg."""
        effects: list[Effect] = []
        if command.lost:
            effects += self.drop(servos, Reason.OVERFLOW, _LOST)
        # If a stream above the rate keeps stopping a stopped servo of a leg that it moves, the repeats suffice.
        first = [servo for servo in servos if not beside or servo.running or not servo.repeats_left]
        effects += stops(leg, first, Cause.COMMAND, (command,))
        for servo in servos:
            effects += self._replaced(servo)
            servo.note_stop(command.channel, self.instant_ns)
            servo.waiting = servo.from_cdeg = None
            if servo in first:
                self._stopped(servo, now_ns)
            effects += self._target_done(command)
        leg.expired = leg.expired and len(servos) < len(leg.servos)
        return effects if beside else effects + self._empty_start_queue(command)

    def _take(self, leg: Leg, targets: Targets, command: Command, now_ns: int) -> list[Effect]:
        """Let a command's targets for a leg that it starts or sets wait for their frame."""
        effects: list[Effect] = []
        taken: list[Servo] = []
        for servo_id, op in targets:
            servo, newest = self.servos[servo_id], op
            if servo.waiting is not None:
                if op.op is OP_SET and servo.waiting.op is OP_START:
                    newest = STARTS[op.angle_cdeg]  # a waiting start stays a start
                effects += self._replaced(servo)
            servo.waiting, servo.waiting_for, servo.begun = newest, command, False
            if servo.source != command.source or servo.angle_cdeg is None:
                taken += [servo]
        if taken:
            self._speeds.take_over(leg, taken, command.source, now_ns)
        return effects

    def _send(self, leg: Leg, now_ns: int, cause: Cause = Cause.COMMAND) -> list[Effect]:
        """Return the frame for this leg's waiting targets, if it may leave now."""
        held = () if self.fed is None else self._held()
        waiting: list[tuple[Servo, ServoOp]] = []
        starts = False
        for servo in leg.servos:
            op = servo.waiting
            if op is not None and servo not in held:
                waiting += [(servo, op)]
                starts = starts or servo.angle_cdeg is None
        if not waiting:
            return []
        queue, slots = self._queue, leg.slots
        if (queue.legs or (starts and queue.pause_ns)) and not queue.passes(leg.number, slots, now_ns, starts):
            return []
        if now_ns < (self._slot_ns(leg) if self._rules.starts_whole else slots.next_ns):
            return []
        slots.take(now_ns)
        if leg.eases or self._rules.max_speed_cdeg_s:
            waiting = self._speeds.in_steps(leg, waiting, now_ns)
        frame = frame_of(leg, waiting)
        wire = self.limits.wire  # here alone, users' angles become the servos' own; a Stop has no angle
        commands, done = self._note_written(leg, waiting)
        return [Transmit(frame if wire is None else wire.frame(frame), cause, None, commands, done)]

    def _note_written(
        self, leg: Leg, written: list[tuple[Servo, ServoOp]]
    ) -> tuple[tuple[Command, ...], tuple[Command, ...]]:
        """Record a frame with these operations. Return the commands that it carries out, and those it completes."""
        commands: tuple[Command, ...] = ()
        done: tuple[Command, ...] = ()
        for servo, op in written:
            target, servo.waiting = servo.waiting, None
            servo.angle_cdeg, servo.from_cdeg = op.angle_cdeg, None
            servo.repeats_left = 0  # started again: a repeated Stop would undo it
            leg.expired = False
            if not servo.begun:
                command = servo.waiting_for
                commands += () if command in commands else (command,)
                command.left -= 1
                done += () if command.left else (command,)
            if target is not op and target is not None and target.angle_cdeg != op.angle_cdeg:  # a step towards it
                servo.waiting, servo.begun = SETS[target.angle_cdeg], True
        return commands, done

    # ---- landing

    def begin_landing(self, now_ns: int, ends_ns: int) -> list[Effect]:
        """Begin to move each running servo to its angle of the pose until `ends_ns`. Reject all waiting commands."""
        pose_cdeg = self.limits.landing_cdeg()
        ways = {
            servo.servo_id: (servo.angle_cdeg, pose_cdeg.get(servo.servo_id, servo.angle_cdeg))
            for servo in self.servos.values()
            if servo.angle_cdeg is not None
        }
        period_ns = self._rules.period_ns
        self.landing = Landing(now_ns, ends_ns, max(period_ns, self._rules.landing_ns - 2 * period_ns), period_ns, ways)
        self.land_ns = now_ns + period_ns
        for leg in self:
            leg.source, leg.landed_ns = None, 0
            for servo in leg.servos:
                servo.eases = False  # the landing has its own pace
        return self.drop(self.servos.values(), Reason.LANDING, "the robot lands, and is then stopped")

    def land(self, now_ns: int) -> list[Effect]:
        """Return the landing's due frames: only for running servos, so that nothing is started."""
        effects: list[Effect] = []
        if self.landing is None or now_ns < self.land_ns:
            return effects
        self.land_ns += self._rules.period_ns  # not now_ns + period: late timers would add up
        if self.land_ns <= now_ns:
            self.land_ns = now_ns + self._rules.period_ns
        for leg in self:
            if now_ns < leg.slots.next_ns:
                continue
            leg.landed_ns = self.landing.next_part_ns(leg.landed_ns, now_ns)
            for servo in leg.servos:
                if servo.angle_cdeg is not None:
                    angle_cdeg = self.landing.angle_cdeg(servo.servo_id, leg.landed_ns)
                    angle_cdeg = self.limits.near_side(servo.servo_id, servo.angle_cdeg, angle_cdeg)
                    if angle_cdeg != servo.angle_cdeg:
                        servo.waiting, servo.begun = SETS[angle_cdeg], True  # for no command
            effects += self._send(leg, now_ns, Cause.WATCHDOG)
            for servo in leg.servos:
                servo.waiting = None  # a servo with a limited speed follows the line, not an earlier point of it
        return effects

    def stop(
        self, deadlines_ns: Mapping[int, int | None], cause: Cause, now_ns: int, reason: Reason, detail: str
    ) -> list[Effect]:
        """Stop legs for the gateway's own reasons. `deadlines_ns` has when each leg's Stop was due.

        Commands that wait for these legs are rejected with `reason` and `detail`.
        """
        transmits = [Transmit(stop_leg(number), cause, deadline) for number, deadline in deadlines_ns.items()]
        self._silent = self._silent or cause is Cause.WATCHDOG
        servos = [servo for number in deadlines_ns for servo in self.by_number[number].servos]
        dropped = self.drop(servos, reason, detail)
        for servo in servos:
            servo.note_stop(cause, self.instant_ns)
            self._stopped(servo, now_ns)
            if cause is Cause.STARTUP:
                servo.stopped = None  # after a bus fault the last frame is not known
        for number in deadlines_ns:
            self.by_number[number].expired = False
            self.by_number[number].source = None
        return [*transmits, *dropped, *self._empty_start_queue()]

    def _stopped(self, servo: Servo, now_ns: int) -> None:
        self._first_stops.add(servo.servo_id)
        self.stopping.add(servo.servo_id)
        if servo.angle_cdeg is not None:
            servo.stopped, servo.eases = (servo.angle_cdeg, now_ns, self.limits.calibration), False
        servo.angle_cdeg = servo.waiting = servo.from_cdeg = servo.passing_cdeg = None
        if not servo.repeats_left:  # else the next repeat keeps its time
            servo.repeat_ns = now_ns + self._rules.repeat_interval_ns
        servo.repeats_left = self._rules.repeats

    def _empty_start_queue(self, own: Command | None = None) -> list[Effect]:
        """Drop all waiting starts after a Stop of any leg, except those of the Stop's `own` command.

        A person who stops one leg does not want another to start.
        """
        pauses = self._queue.pause_ns > 0
        legs = [leg for leg in self if leg.number in self._queue.legs or (pauses and leg.unfed_ns is not None)]
        servos = (servo for leg in legs for servo in leg.servos)
        waiting = [servo for servo in servos if servo.pending and servo.waiting_for is not own]
        return self.drop(waiting, Reason.SERVO_STOPPED, "a Stop was received before the start")

    # ---- commands under way

    def _replaced(self, servo: Servo) -> list[Effect]:
        """Drop a servo's waiting target for a newer one, and mark its command as coalesced."""
        if not servo.pending:
            return []
        servo.waiting = None
        servo.waiting_for.coalesced = True
        return self._target_done(servo.waiting_for)

    def _target_done(self, command: Command) -> list[Effect]:
        """Count a target of the command that is replaced or stopped."""
        command.left -= 1
        return [] if command.left else [Completed(command)]

    def drop(self, servos: Collection[Servo], reason: Reason, detail: str) -> list[Effect]:
        """Drop these servos' waiting targets, and reject the commands that set them, as a whole."""
        rejected = dict.fromkeys([each.waiting_for for each in servos if each.waiting is not None and not each.begun])
        for servo in self.servos.values():  # a rejected command must not take effect on another leg, nor continue there
            if servo.waiting is not None and servo.waiting_for in rejected:
                servo.waiting = servo.from_cdeg = servo.passing_cdeg = None
        for servo in servos:  # nor does one of these continue to an earlier command's target
            servo.waiting = servo.passing_cdeg = None
        for number in tuple(self._queue.legs):
            if not self.by_number[number].waits_to_start:
                self._queue.leave(number)
        return [withdrawn(command, reason, detail) for command in rejected]
