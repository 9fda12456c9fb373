"""What the supervisor keeps of each leg and servo, and how a leg's commands become frames: pure, time as an argument.

The rules that decide whether something may happen are the supervisor's; here is how it then happens: which targets wait
for their leg's turn, what one frame says for three servos, which Stops are still to be repeated, and which commands are
thereby done.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from gateway.events import Command, Effect, Refused, Settled, Transmit
from gateway.pacing import NS_PER_MS, NS_PER_S, StartQueue, Turn, Waiting, merged
from gateway.protocol.frames import STOP, OneLeg, OneServo, Op, ServoOp, leg_of, servo_ids_of, stop_leg
from schemas.robot import LEGS
from schemas.telemetry import Cause, Reason, WatchdogState


@dataclass(frozen=True, slots=True)
class Rules:
    """The settings that the supervisor needs, in nanoseconds and hundredths of a degree."""

    timeout_ns: int = 250 * NS_PER_MS
    whole_robot: bool = False
    repeats: int = 3
    repeat_interval_ns: int = 20 * NS_PER_MS
    period_ns: int = NS_PER_S // 50
    start_pause_ns: int = 0
    joint_limits_cdeg: dict[int, tuple[int, int]] = field(default_factory=dict)


@dataclass(slots=True)
class Servo:
    """One servo as last written; `angle_cdeg` is None while it does not run, for then nobody knows where it hangs."""

    servo_id: int
    angle_cdeg: int | None = None
    waiting: Waiting | None = None
    repeats_left: int = 0
    repeat_ns: int = 0
    stopped_at: tuple[int, str] | None = None

    @property
    def running(self) -> bool:
        return self.angle_cdeg is not None

    @property
    def will_run(self) -> bool:
        """Whether a `set` has something to set: the servo runs, or waits to be started."""
        return self.running or (self.waiting is not None and self.waiting.op.op is Op.START)


@dataclass(slots=True)
class Leg:
    """One leg: its servos, its turns, and when it was last heard."""

    number: int
    servos: tuple[Servo, Servo, Servo]
    turn: Turn
    heard_ns: int | None = None
    expired: bool = False

    @property
    def waits(self) -> bool:
        return any(servo.waiting for servo in self.servos)

    @property
    def watched(self) -> bool:
        return any(servo.will_run for servo in self.servos)

    def deadline_ns(self, timeout_ns: int) -> int | None:
        """When the watchdog stops this leg; None while there is nothing to stop."""
        return self.heard_ns + timeout_ns if self.heard_ns is not None and self.watched else None

    @property
    def watchdog(self) -> WatchdogState:
        if self.expired:
            return WatchdogState.EXPIRED
        return WatchdogState.ARMED if self.watched else WatchdogState.IDLE


@dataclass(slots=True)
class _Order:
    """A command under way: how many of its targets still wait, and whether a newer command replaced one."""

    targets: int
    coalesced: bool = False


def _whole_leg(leg: Leg) -> OneLeg:
    """All three servos in one frame; one that nothing waits for is told what it does already."""
    first, second, third = (
        servo.waiting.op
        if servo.waiting is not None
        else STOP
        if servo.angle_cdeg is None
        else ServoOp(Op.SET, servo.angle_cdeg)
        for servo in leg.servos
    )
    return OneLeg(leg.number, (first, second, third))


def _servos_of(leg: int) -> tuple[Servo, Servo, Servo]:
    first, second, third = servo_ids_of(leg)
    return Servo(first), Servo(second), Servo(third)


class Legs:
    """The six legs, and the commands under way on them."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.by_number = {number: Leg(number, _servos_of(number), Turn(rules.period_ns)) for number in LEGS}
        self.servos = {servo.servo_id: servo for leg in self.by_number.values() for servo in leg.servos}
        self._orders: dict[int, _Order] = {}
        self._queue = StartQueue(rules.start_pause_ns)

    def __iter__(self) -> Iterator[Leg]:
        return iter(self.by_number.values())

    # ---- time

    def due_ns(self) -> int | None:
        """When a deadline, a repeat or a turn comes next."""
        due: list[int] = []
        for leg in self:
            deadline = leg.deadline_ns(self._rules.timeout_ns)
            if deadline is not None:
                due.append(deadline)
            due.extend(servo.repeat_ns for servo in leg.servos if servo.repeats_left)
            if leg.waits:
                turn_ns = self._queue.turn_ns(leg.number, leg.turn.next_ns)
                if turn_ns is not None:
                    due.append(turn_ns)
        return min(due, default=None)

    def repeat_stops(self, now_ns: int) -> list[Effect]:
        """The repeated Stops that are due."""
        return [effect for leg in self for effect in self._repeat(leg, now_ns)]

    def take_turns(self, now_ns: int) -> list[Effect]:
        """The frames of the legs that waited until now."""
        return [effect for leg in self for effect in self._send(leg, now_ns, something_waited=True)]

    def forget_repeats(self) -> None:
        """No Stop is repeated any more."""
        for servo in self.servos.values():
            servo.repeats_left = 0

    # ---- commands

    def apply(self, command: Command, now_ns: int) -> list[Effect]:
        """Carry out an accepted command."""
        by_leg: dict[int, list[tuple[Servo, ServoOp]]] = {}
        for servo_id, op in command.targets:
            by_leg.setdefault(leg_of(servo_id), []).append((self.servos[servo_id], op))
        self._orders[command.order] = _Order(len(command.targets))
        effects: list[Effect] = []
        for number, targets in by_leg.items():
            leg = self.by_number[number]
            leg.heard_ns = now_ns
            if all(op.op is Op.STOP for _, op in targets):
                effects += self._stop_on_command(leg, targets, command, now_ns)
            else:
                effects += self._move(leg, targets, command, now_ns)
        return effects

    def _stop_on_command(
        self, leg: Leg, targets: list[tuple[Servo, ServoOp]], command: Command, now_ns: int
    ) -> list[Effect]:
        """A command that only stops: its frame goes out now, whatever waits."""
        servos = [servo for servo, _ in targets]
        whole = len(servos) == len(leg.servos)
        frame = stop_leg(leg.number) if whole else OneServo(servos[0].servo_id, STOP)
        effects: list[Effect] = [Transmit(frame, Cause.COMMAND)]
        for servo in servos:
            effects += self._replace(servo, None)
            self._stopped(servo, now_ns, command.channel)
            effects += self._target_done(command.order)
        leg.expired = leg.expired and not whole
        return effects + self._empty_queue()

    def _move(self, leg: Leg, targets: list[tuple[Servo, ServoOp]], command: Command, now_ns: int) -> list[Effect]:
        """A command that starts or sets (and may stop some servos as well): it waits for the leg's turn."""
        something_waited = leg.waits
        effects: list[Effect] = []
        for servo, op in targets:
            newest = merged(servo.waiting.op if servo.waiting else None, op)
            effects += self._replace(servo, Waiting(newest, command.order))
            if op.op is Op.STOP:
                servo.stopped_at = (now_ns, command.channel)
        effects += self._send(leg, now_ns, something_waited=something_waited)
        for servo, _ in targets:
            # The leg's turn has not come. Its moves wait; its Stops do not.
            if servo.waiting is not None and servo.waiting.op.op is Op.STOP:
                servo.waiting = None
                if servo.running:
                    effects.append(Transmit(OneServo(servo.servo_id, STOP), Cause.COMMAND))
                    self._stopped(servo, now_ns, command.channel)
                effects += self._target_done(command.order)
        return effects

    def _send(self, leg: Leg, now_ns: int, *, something_waited: bool) -> list[Effect]:
        """Send what waits for this leg, if it may go now."""
        waiting = [(servo, servo.waiting) for servo in leg.servos if servo.waiting is not None]
        if not waiting or not leg.turn.is_open(now_ns, something_waits=something_waited):
            return []
        energises = any(servo.will_run and not servo.running for servo, _ in waiting)
        if energises and not self._queue.admits(leg.number, now_ns):
            return []
        if energises:
            self._queue.started(leg.number, now_ns)
        else:
            self._queue.leave(leg.number)
        leg.turn.take(now_ns)
        frame = OneServo(waiting[0][0].servo_id, waiting[0][1].op) if len(waiting) == 1 else _whole_leg(leg)
        effects: list[Effect] = [Transmit(frame, Cause.COMMAND)]
        for servo, target in waiting:
            servo.waiting = None
            if target.op.op is Op.STOP:
                self._stopped(servo, now_ns, servo.stopped_at[1] if servo.stopped_at else "")
            else:
                servo.angle_cdeg = target.op.angle_cdeg
                servo.repeats_left = 0  # started again: a repeated Stop would undo it
                leg.expired = False
            effects += self._target_done(target.order)
        return effects

    def stop(
        self, leg: Leg, cause: Cause, now_ns: int, reason: Reason, detail: str, *, deadline_ns: int | None = None
    ) -> list[Effect]:
        """Stop a leg for the gateway's own reasons; what waited for it is refused with `reason`."""
        transmit = Transmit(stop_leg(leg.number), cause, deadline_ns)
        dropped = self.drop(leg.servos, reason, detail)
        for servo in leg.servos:
            self._stopped(servo, now_ns, str(cause))
        leg.expired = False
        return [transmit, *dropped, *self._empty_queue()]

    def _stopped(self, servo: Servo, now_ns: int, channel: str) -> None:
        servo.angle_cdeg = None
        servo.stopped_at = (now_ns, channel)
        servo.repeats_left = self._rules.repeats
        servo.repeat_ns = now_ns + self._rules.repeat_interval_ns

    def _empty_queue(self) -> list[Effect]:
        """A Stop anywhere ends what waits to be energised: whoever stops one leg does not want another to start now."""
        waiting = [servo for number in self._queue.legs for servo in self.by_number[number].servos]
        self._queue.legs.clear()
        return self.drop(waiting, Reason.SERVO_STOPPED, "a Stop came before its turn to be started")

    # ---- commands under way

    def _replace(self, servo: Servo, newer: Waiting | None) -> list[Effect]:
        """A newer target for a servo: the command whose target waited until now will not see it sent."""
        older, servo.waiting = servo.waiting, newer
        if older is None or older.order not in self._orders:
            return []
        self._orders[older.order].coalesced = True
        return self._target_done(older.order)

    def _target_done(self, number: int) -> list[Effect]:
        order = self._orders.get(number)
        if order is None:
            return []  # it was refused meanwhile
        order.targets -= 1
        if order.targets:
            return []
        del self._orders[number]
        return [Settled(number, order.coalesced)]

    def drop(self, servos: Iterable[Servo], reason: Reason, detail: str) -> list[Effect]:
        """Forget what waits for these servos, and refuse the commands that it came from."""
        refused: dict[int, None] = {}
        for servo in servos:
            if servo.waiting is not None:
                if self._orders.pop(servo.waiting.order, None) is not None:
                    refused[servo.waiting.order] = None
                servo.waiting = None
            self._queue.leave(leg_of(servo.servo_id))
        return [Refused(number, reason, detail) for number in refused]

    def _repeat(self, leg: Leg, now_ns: int) -> list[Effect]:
        due = [servo for servo in leg.servos if servo.repeats_left and now_ns >= servo.repeat_ns]
        for servo in due:
            servo.repeats_left -= 1
            servo.repeat_ns = now_ns + self._rules.repeat_interval_ns
        if len(due) == len(leg.servos):
            return [Transmit(stop_leg(leg.number), Cause.REPEAT)]
        return [Transmit(OneServo(servo.servo_id, STOP), Cause.REPEAT) for servo in due]
