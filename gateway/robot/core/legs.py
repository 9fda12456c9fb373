"""Carries out accepted commands: what a servo's frame contains, and when a command is done. Pure: time is an argument.

The supervisor decides whether a command is carried out. *When* a frame leaves is decided in `gates.py`, *how far* it
moves a servo in `pace.py`, *which Stops are owed* in `stops.py`. A servo's own state is in `servo.py`.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from gateway.model.angle_limits import AngleLimits
from gateway.model.frames import OP_STOP, SETS, STOP, Frame, ServoOp, frame_of
from gateway.robot.core.events import (
    NOBODY,
    Announce,
    Command,
    Completed,
    Effect,
    Rejected,
    Sender,
    Targets,
    Transmit,
)
from gateway.robot.core.gates import NEVER, Gates
from gateway.robot.core.leg import Leg, leg_at_rest
from gateway.robot.core.pace import Paces
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import OFF, RUNNING, WAITING, Servo
from gateway.robot.core.stops import StopSchedule, stops
from gateway.words.text import legs_named
from schemas.keys import LEGS_COMMAND
from schemas.robot import LEGS
from schemas.words import Cause, Kind, Reason

_COMMAND: Final = Cause.COMMAND  # see `frames.OP_STOP`
_BY: Final = {
    **dict.fromkeys((Cause.STARTUP, Cause.SHUTDOWN), "the gateway"),
    Cause.WATCHDOG: "the watchdog",
    Cause.ESTOP: "the emergency stop",
}
"""Who stops legs, by the cause; a command's is its source."""
_LOST: Final = "messages of the same key were lost, and a stop may be among them"
_PARTLY: Final = (
    "this robot can only be started as a whole: send one command with a start for each joint of all six legs to "
    f"{LEGS_COMMAND}"
)
_MIXED: Final = "this robot only stops as a whole: a Stop in this command stopped it, and its moves are dropped"


class Halt(NamedTuple):
    """Stops at once, by which waiting commands are rejected."""

    cause: Cause
    reason: Reason
    detail: str
    sender: Sender = NOBODY
    """Who asked for it."""


class Legs:
    """The six legs, and the pending commands of each."""

    # mutants accepted (Step, TrueWithFalse): set before it is read
    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.limits = AngleLimits(rules.joint_limits_cdeg, rules.landing_cdeg, rules.avoid_cdeg)
        self.by_number = {number: leg_at_rest(number, rules.period_ns) for number in LEGS}
        self._all = tuple(self.by_number.values())
        self.servos = {servo.servo_id: servo for leg in self._all for servo in leg.servos}
        self.gates = Gates(rules, self.by_number)
        self._pace = Paces(rules, self.limits)
        self.stops = StopSchedule(rules, self._all)
        self.sends = False
        """Whether the bus is open and not at fault."""
        self.landing_ends_ns: int | None = None
        """When all six legs get their Stop, at any angle; None: the robot does not land."""
        self.landing_from_ns = 0
        """When the landing's first frames are due: until then no servo has a way to go."""
        self.stopped_ns = -1
        """The instant (ns) of the latest Stop, whose order with a move of the same instant is not known."""
        self.at_rest = True
        """Whether no servo of any leg runs; as of the last `plan`."""
        self.begin(0)
        self.plan(0)

    def __iter__(self) -> Iterator[Leg]:
        return iter(self._all)

    @property
    def running(self) -> bool:
        """Whether a servo runs now, even within a step."""
        return any(leg.runs for leg in self._all)

    # ---- a step's begin and end

    def begin(self, instant_ns: int) -> None:
        """Begin a step of this instant (ns)."""
        self.instant_ns = instant_ns
        """When the present instant began; see `Supervisor.step`."""
        self.gates.supply.begin()
        self.stops.begin()
        self._halted: dict[tuple[Cause, Sender], set[int]] = {}
        """The legs whose servos ran or waited to start before a Stop of this step, by its cause and sender."""

    def plan(self, now_ns: int) -> None:  # mutants accepted (Lt_LtE): equal times
        """End a step: compute what is due next, and whether anything runs."""
        due_ns, runs, rests = NEVER, False, False
        for leg in self._all:
            leg.steady_for = None
            one, two, three = leg.servos
            lives = (one.life, two.life, three.life)
            if RUNNING in lives or WAITING in lives:
                leg_due_ns = self._leg_due_ns(leg, now_ns, runs=RUNNING in lives)
                due_ns = leg_due_ns if leg_due_ns < due_ns else due_ns
                runs = runs or RUNNING in lives
            else:
                leg.unfed_ns, rests = None, True
        self.stops.plan(now_ns, ran=not self.at_rest, runs=runs, rests=rests)
        if self.stops.due_ns is not None:
            due_ns = min(due_ns, self.stops.due_ns)
        self.due_ns = None if due_ns == NEVER else due_ns
        """When the next deadline, Stop or rate slot is due; as of the last `plan`."""
        self.at_rest = not runs

    def _leg_due_ns(self, leg: Leg, now_ns: int, *, runs: bool) -> int:
        """Return when the next deadline or frame of a leg that is not at rest is due."""
        if self.gates.supply.fed is not None:
            held = any(self.gates.supply.holds(each) and not self.gates.burst.holds(each) for each in leg.servos)
            if not held or leg.unfed_ns is None:
                leg.unfed_ns = now_ns if held else None
        deadline_ns, slot_ns = leg.deadline_ns(self._rules.timeout_ns), leg.slots.next_ns
        if self.landing_ends_ns is not None and runs:
            deadline_ns, slot_ns = self.landing_ends_ns, max(slot_ns, self.landing_from_ns)
        due_ns = NEVER if deadline_ns is None else deadline_ns
        if leg.unfed_ns is not None:
            due_ns = min(due_ns, leg.unfed_ns + self._rules.feed_ns)
        for servo in leg.servos:
            if servo.target is not None:
                opens_ns = slot_ns if servo.life is RUNNING else max(slot_ns, self.gates.opens_ns(servo))
                if self.gates.burst.holds(servo):
                    opens_ns = self.gates.burst.opens_ns(servo)  # it is judged then
                due_ns = opens_ns if opens_ns < due_ns else due_ns
        return due_ns

    # ---- commands

    def apply(self, command: Command, now_ns: int) -> list[Effect]:
        """Carry out an accepted command, its Stops first, and return its effects."""
        by_leg, effects = command.by_leg, list[Effect]()
        stops_some = len(command.moves) < len(command.targets)
        whole = self._rules.starts_whole and stops_some
        if whole:  # all servos get a Stop; the moves are never written, so a command with moves is not completed
            command.left += len(self.servos) - len(command.stops)
            by_leg = {leg.number: tuple((servo.servo_id, STOP) for servo in leg.servos) for leg in self}
        taken = self._taken_over(command, by_leg)
        moved = [self.by_number[number] for number, targets in by_leg.items() if _moves(targets)]
        for leg in moved:
            leg.commanded_ns = now_ns  # a Stop does not count: it does not keep the leg's other servos running
            for servo_id, op in by_leg[leg.number]:
                if op.op is not OP_STOP:
                    effects += self._take(leg, self.servos[servo_id], op, command, now_ns)
        if stops_some:
            effects += self._stop_on_command(command, by_leg, now_ns)
        for leg in self if stops_some else moved:  # only now is it known which starts have to wait for others
            effects += self._send(leg, now_ns)
        if whole and command.moves:
            effects.append(withdrawn(command, Reason.WHOLE_ROBOT, _MIXED))
        return effects + taken

    def stop_for(self, command: Command, rejected: Rejected, now_ns: int, *, write: bool) -> list[Effect]:
        """Carry out only the Stops of a rejected command. Not `write`: the Stops are already written."""
        if not command.stops:
            return [rejected]
        effects: list[Effect] = []
        if write:
            stops = replace(command, targets=command.stops, frames=())
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

    def _taken_over(self, command: Command, by_leg: Mapping[int, Targets]) -> list[Effect]:
        """Set the sender of the command's legs. Return an event for each leg that another sender commanded.

        A stopped leg has no previous sender. A Stop without a name (a delete has none) may be from the previous one.
        """
        taken: list[Effect] = []
        sender, (source, source_id) = command.sender, command.sender
        for number, targets in by_leg.items():
            leg = self.by_number[number]
            if leg.sender != sender:
                (before, _), leg.sender = leg.sender, sender
                if leg.armed and (source is not None or _moves(targets)):
                    new, old = ("somebody without a name" if name is None else name for name in (source, before))
                    old = f"another program named {old!r}" if source is not None and source == before else old
                    detail = f"leg {number} is commanded by {new}, and was by {old}"
                    taken.append(Announce(Kind.SOURCE_CHANGED, detail, source, legs=(number,), source_id=source_id))
        return taken

    def _stop_on_command(self, command: Command, by_leg: Mapping[int, Targets], now_ns: int) -> list[Effect]:
        """Carry out a command's Stops: their frames leave now."""
        effects: list[Effect] = []
        stopped = [self.servos[servo_id] for targets in by_leg.values() for servo_id, op in targets if op.op is OP_STOP]
        self._note_halt(stopped, Cause.COMMAND, command.sender)  # now: the first leg's Stop drops the starts of all
        for number, targets in by_leg.items():
            leg = self.by_number[number]
            servos = [self.servos[servo_id] for servo_id, op in targets if op.op is OP_STOP]
            # If a stream above the rate keeps stopping a stopped servo of a leg that it moves, the repeats suffice.
            moves = len(servos) < len(targets)
            at_once = not moves or now_ns >= leg.slots.next_ns
            sent = [each for each in servos if at_once or each.will_run or not self.stops.repeats(each.servo_id)]
            effects += stops(leg, sent, Cause.COMMAND, commands=(command,))
            if command.lost:
                effects += self.drop(servos, Reason.OVERFLOW, _LOST)
            for servo in servos:
                effects += self._replaced(servo)
                servo.stop(command.channel, self.instant_ns, now_ns, self.limits.calibration)
                effects += self._target_done(command)
            self.stops.first(sent, now_ns)
            if servos and not moves:
                leg.expired = leg.expired and len(servos) < len(leg.servos)
                effects += self._drop_staggered(command)
        return effects

    def _take(self, leg: Leg, servo: Servo, op: ServoOp, command: Command, now_ns: int) -> list[Effect]:
        """Let a command's target wait for its leg's frame."""
        effects = self._replaced(servo)
        if servo.sender != command.sender:
            self._pace.take_over(leg, servo)
        servo.take(op, command, self._pace.begin_cdeg(servo, op, now_ns))
        return effects

    # ---- frames that move

    def take_slots(self, now_ns: int) -> list[Effect]:
        """Return the frames of the legs that may move now."""
        return [effect for leg in self for effect in self._send(leg, now_ns)]

    def start_fed(self, now_ns: int) -> list[Effect]:
        """Return the starts that waited for power, within their legs' rate slots, and arm these legs' deadlines."""
        for leg in self:
            if leg.unfed_ns is not None and not leg.runs and not any(map(self.gates.supply.holds, leg.servos)):
                leg.commanded_ns = now_ns
        return self.take_slots(now_ns)

    def to_feed(self) -> dict[int, int | None]:
        """Return the servos to power: running ones (None), and waiting starts with their wire angle (0.01 degrees).

        Supply may start a servo at this angle, so it stays the same while the start waits. With the bus at fault, no
        servo is powered.
        """
        found: dict[int, int | None] = {}
        for servo_id, servo in self.servos.items() if self.sends else ():
            if servo.life is RUNNING:
                found[servo_id] = None
            elif servo.target is not None and not self.gates.burst.holds(servo):
                angle_cdeg = servo.target.angle_cdeg if servo.from_cdeg is None else servo.from_cdeg
                found[servo_id] = self.limits.calibration.of(servo_id).wire_cdeg(angle_cdeg)
        return found

    def _send(self, leg: Leg, now_ns: int) -> list[Effect]:
        """Return the frame for this leg's targets that may leave now, if there is one."""
        lands = self.landing_ends_ns is not None
        if now_ns < leg.slots.next_ns or (lands and now_ns < self.landing_from_ns):
            return []
        waiting = [servo for servo in leg.servos if servo.target is not None]
        ready = [each for each in waiting if each.life is RUNNING or now_ns >= self.gates.opens_ns(each)]
        if not ready:
            return []
        before_ns = leg.slots.taken_ns
        leg.slots.take(now_ns)
        if any(servo.life is WAITING for servo in ready):
            self.gates.stagger.started(now_ns)
        commands, done = self._carried_out(ready)
        named = [(servo, self._pace.step(servo, now_ns, before_ns, lands=lands)) for servo in ready]
        leg.expired = False
        for servo in ready:
            self.stops.started(servo.servo_id)
        frame = self._frame(leg, named, now_ns)
        wire = self.limits.wire  # here alone, users' angles become the servos' own; a Stop has no angle
        cause = Cause.WATCHDOG if lands else Cause.COMMAND
        return [Transmit(frame if wire is None else wire.frame(frame), cause, None, commands, done)]

    def _frame(self, leg: Leg, named: Sequence[tuple[Servo, ServoOp]], now_ns: int) -> Frame:
        """Return the frame with these operations. If it names two servos, the third repeats its current state."""
        ops = {each.servo_id: op for each, op in named}
        if len(ops) != 2:
            return frame_of(tuple(ops.items()))
        for each in leg.servos:
            if each.servo_id not in ops:
                each.repeated(now_ns)
                ops[each.servo_id] = STOP if each.angle_cdeg is None else SETS[each.angle_cdeg]
        return frame_of(tuple((each.servo_id, ops[each.servo_id]) for each in leg.servos))

    def _carried_out(self, ready: Iterable[Servo]) -> tuple[tuple[Command, ...], tuple[Command, ...]]:
        """Return the commands that a frame with these servos' targets carries out, and those that it completes."""
        commands: tuple[Command, ...] = ()
        done: tuple[Command, ...] = ()
        for servo in ready:
            if not servo.begun:
                command = servo.command
                commands += () if command in commands else (command,)
                command.left -= 1
                done += () if command.left else (command,)
        return commands, done

    # ---- landing

    def land(self, now_ns: int, ends_ns: int) -> list[Effect]:
        """Begin to move each running servo to its angle of the pose until `ends_ns`. Reject all waiting commands."""
        effects = self.drop(self.servos.values(), Reason.LANDING, "the robot lands, and is then stopped")
        self.landing_ends_ns, pose_cdeg = ends_ns, self.limits.landing_cdeg()
        self.landing_from_ns = now_ns + self._rules.period_ns
        for leg in self:
            leg.sender = NOBODY
            for servo in leg.servos:
                if servo.life is RUNNING and servo.servo_id in pose_cdeg:
                    self._pace.land(servo, pose_cdeg[servo.servo_id], now_ns)
        return effects

    # ---- Stops

    def stop(self, deadlines_ns: Mapping[int, int | None], halt: Halt, now_ns: int) -> list[Effect]:
        """Stop legs, and reject what waits for them. `deadlines_ns` has when each Stop was due."""
        cause, reason, detail, sender = halt
        legs = [self.by_number[number] for number in deadlines_ns]
        transmits = [
            stop for leg in legs for stop in stops(leg, leg.servos, cause, deadline_ns=deadlines_ns[leg.number])
        ]
        if cause is Cause.WATCHDOG:
            self.stops.silent = True
        servos = [servo for leg in legs for servo in leg.servos]
        self._note_halt(servos, cause, sender)
        dropped = self.drop(servos, reason, detail)
        calibration = None if cause is Cause.STARTUP else self.limits.calibration
        for servo in servos:
            servo.stop(cause, self.instant_ns, now_ns, calibration)
        self.stops.first(servos, now_ns)
        for leg in legs:
            leg.expired, leg.sender = False, NOBODY
        return [*transmits, *dropped, *self._drop_staggered()]

    def _note_halt(self, servos: Iterable[Servo], cause: Cause, sender: Sender) -> None:
        """Record the legs whose servos run or wait to start until now. Call it before a waiting start is dropped."""
        self.stopped_ns = self.instant_ns
        legs = {servo.servo_id // 10 for servo in servos if servo.life is not OFF}
        if legs:
            self._halted[cause, sender] = self._halted.get((cause, sender), set()) | legs

    def halted(self) -> list[Announce]:
        """Return the events of legs that this step has stopped: one for each cause, and each sender that asked."""
        effects = []
        for (cause, (source, source_id)), legs in self._halted.items():
            by = _BY.get(cause, "somebody without a name" if source is None else source)
            stopped = tuple(sorted(legs))
            detail = f"{by} stopped {legs_named(stopped)}"
            effects += [Announce(Kind.LEGS_STOPPED, detail, source, None, stopped, None, "", source_id, cause)]
        return effects

    def _drop_staggered(self, own: Command | None = None) -> list[Effect]:
        """Drop all starts that wait in turn after a Stop of any leg, except those of the Stop's `own` command.

        A person who stops one leg does not want another to start.
        """
        if not self._rules.start_pause_ns:
            return []
        waiting = [each for each in self.servos.values() if each.life is WAITING and each.command is not own]
        return self.drop(waiting, Reason.SERVO_STOPPED, "a Stop was received before the start")

    # ---- commands under way

    def _replaced(self, servo: Servo) -> list[Effect]:
        """Mark the command of a servo's pending target, which a newer one replaces, as coalesced."""
        if not servo.pending:
            return []
        servo.command.coalesced = True
        return self._target_done(servo.command)

    def _target_done(self, command: Command) -> list[Effect]:
        """Count a target of the command that is replaced or stopped."""
        command.left -= 1
        return [] if command.left else [Completed(command)]

    def drop(self, servos: Collection[Servo], reason: Reason, detail: str) -> list[Effect]:
        """Drop these servos' waiting targets, and reject the commands that set them, as a whole."""
        rejected = dict.fromkeys([servo.command for servo in servos if servo.pending])
        for servo in self.servos.values():  # a rejected command must not take effect on another leg, nor continue there
            if servo.target is not None and servo.command in rejected:
                servo.drop()
        for servo in servos:  # nor does one of these continue to an earlier command's target
            servo.drop()
        return [withdrawn(command, reason, detail) for command in rejected]


def moves_of(command: Command, frames: Sequence[Frame]) -> list[Transmit]:
    """Return the effects that write these frames, the last of which completes the command."""
    commands, last = (command,), frames[-1]
    return [Transmit(each, _COMMAND, None, commands, commands if each is last else ()) for each in frames]


def _moves(targets: Targets) -> bool:
    return any(op.op is not OP_STOP for _, op in targets)


def withdrawn(command: Command, reason: Reason, detail: str) -> Rejected:
    """Return the rejection of a command that is dropped. Its Stops were written, unless the bus failed."""
    if reason is not Reason.BUS_FAULT:
        command.stopped = tuple(servo_id for servo_id, _ in command.stops)
    return Rejected(command, reason, detail)
