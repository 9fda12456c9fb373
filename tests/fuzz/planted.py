"""Supervisors with a bug each, for the model check to find."""

from dataclasses import replace
from typing import Any

from gateway.robot.core.events import (
    Command,
    Effect,
    EmergencyStop,
    Event,
    Rejected,
    Reset,
    StoppedOutside,
)
from gateway.robot.core.joint_limits import Reach
from gateway.robot.core.leg import Leg, Rules, Servo
from gateway.robot.core.legs import Legs
from gateway.robot.core.pacing import RateSlots, StartQueue
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Cause, Reason


class WatchdogWithoutWaitingStarts(Leg):
    """The watchdog looks only at what runs, so a start that waited too long is sent after all."""

    @property
    def armed(self) -> bool:
        return any(servo.running for servo in self.servos)


class WatchdogWithoutJoint3(Leg):
    """A leg of which only the last servo runs has no watchdog."""

    @property
    def armed(self) -> bool:
        first, second, _ = self.servos
        return first.will_run or second.will_run


class StopsFeed(Legs):
    """A Stop for one servo keeps its leg's others running."""

    def apply(self, command: Command, now_ns: int) -> list[Effect]:
        for servo_id, _ in command.targets:
            self.by_number[servo_id // 10].heard_ns = now_ns
        return super().apply(command, now_ns)


class InstantsOfTheirOwn(Supervisor):
    """What was collected together is taken for ordered, as soon as dealing with it takes time."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        del instant_ns
        return super().step(event, now_ns)


class LatchedWhenDealtWith(Supervisor):
    """An emergency stop is as new as the moment in which it was dealt with, so a reset of its instant leaves it."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        effects = super()._emergency_stop(event, now_ns)
        self._latched_ns = now_ns
        return effects


class AnyNumberResets(Supervisor):
    """A reset leaves newer emergency stops than the one that it names."""

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        older = event.estop is not None and event.estop < self.estops
        return super()._reset(replace(event, estop=self.estops) if older else event, now_ns)


class NumbersToComeReset(Supervisor):
    """A reset may name an emergency stop that nobody has requested yet."""

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        newer = event.estop is not None and event.estop > self.estops
        return super()._reset(replace(event, estop=self.estops) if newer else event, now_ns)


class UnnumberedResetsAtOnce(Supervisor):
    """A reset without a number is taken as soon as one that names the latest."""

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        return super()._reset(replace(event, estop=self.estops) if event.estop is None else event, now_ns)


class CountsOnlyTheFirst(Supervisor):
    """Requests while the emergency stop is engaged are not numbered."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        engaged, before = self._latched_ns is not None, self.estops
        effects = super()._emergency_stop(event, now_ns)
        self.estops = before if engaged else self.estops
        return effects


class KeepsTheFirstInstant(Supervisor):
    """Engaging again does not make the emergency stop newer."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        first_ns = self._latched_ns
        effects = super()._emergency_stop(event, now_ns)
        self._latched_ns = self._latched_ns if first_ns is None else first_ns
        return effects


class SetStarts(Servo):
    """A set is accepted after a Stop."""

    @property
    def will_run(self) -> bool:
        return True


class ForgetsOthersStops(Servo):
    """Only the last who stopped a servo in an instant counts."""

    def note_stop(self, by: str, now_ns: int) -> None:
        self.stopped_by, self.stopped_ns = frozenset((by,)), now_ns


class NeverSkips(RateSlots):
    """Every missed slot is made up."""

    def take(self, now_ns: int) -> None:
        self.oldest_ns += self.period_ns
        self.next_ns = max(self.oldest_ns, now_ns + self.period_ns // 4)


class Bursts(RateSlots):
    """What the bucket holds may go out in one instant."""

    def take(self, now_ns: int) -> None:
        super().take(now_ns)
        self.next_ns = self.oldest_ns


class NoBucket(RateSlots):
    """A stream at the limit waits for its own jitter."""

    def take(self, now_ns: int) -> None:
        self.next_ns = now_ns + self.period_ns


def with_parts(
    *, leg: type[Leg] = Leg, servo: type[Servo] = Servo, slots: type[RateSlots] = RateSlots
) -> type[Supervisor]:
    """A supervisor whose legs are made of other parts."""

    class Planted(Supervisor):
        def __init__(self, rules: Rules) -> None:
            super().__init__(rules)
            for number in self.legs.by_number:
                first, second, third = (servo(s.servo_id, number) for s in self.legs.by_number[number].servos)
                self.legs.by_number[number] = leg(number, (first, second, third), slots(rules.period_ns))

    return Planted


def with_legs(legs: type[Legs]) -> type[Supervisor]:
    """A supervisor with other legs."""

    class Planted(Supervisor):
        def __init__(self, rules: Rules) -> None:
            super().__init__(rules)
            self.legs = legs(rules, self._reach)

    return Planted


class StopsTakeSlots(Legs):
    """A Stop on command waits for the leg's rate slot."""

    def _stop_on_command(self, leg: Leg, servos: list[Servo], command: Command, now_ns: int) -> list[Effect]:
        if now_ns < leg.slots.next_ns:
            return []
        return super()._stop_on_command(leg, servos, command, now_ns)


class RepeatsAfterStart(Legs):
    """Repeats still to come are kept when the servo is started again."""

    def _send(self, leg: Leg, now_ns: int, cause: Cause = Cause.COMMAND) -> list[Effect]:
        kept = [(servo, servo.repeats_left) for servo in leg.servos]
        effects = super()._send(leg, now_ns, cause)
        for servo, repeats in kept:
            servo.repeats_left = repeats
        return effects


class OlderStartSurvivesStop(Legs):
    """A Stop leaves what waits for its servo, which is then sent after it."""

    def _stop_on_command(self, leg: Leg, servos: list[Servo], command: Command, now_ns: int) -> list[Effect]:
        waiting = [(servo, servo.waiting) for servo in servos]
        effects = super()._stop_on_command(leg, servos, command, now_ns)
        for servo, older in waiting:
            servo.waiting = older
            if older is not None:
                self._pending.setdefault(servo.waiting_number, self._pending_of_one())
        return [effect for effect in effects if getattr(effect, "number", None) not in self._pending]

    def _pending_of_one(self) -> Any:
        from gateway.robot.core.legs import _PendingCommand  # noqa: PLC0415

        return _PendingCommand(1)


class RejectedInPart(Legs):
    """What was rejected because of one leg still takes effect on another."""

    def drop(self, servos: Any, reason: Reason, detail: str) -> list[Effect]:
        named = list(servos)
        others = [(servo, servo.waiting) for servo in self.servos.values() if servo not in named]
        effects = super().drop(named, reason, detail)
        for servo, waiting in others:
            servo.waiting = waiting
        return effects

    def _target_done(self, number: int) -> list[Effect]:
        return super()._target_done(number) if number in self._pending else []


class LatchLostInFault(Supervisor):
    """A bus fault loses the emergency stop."""

    def _bus_opened(self, now_ns: int) -> list[Effect]:
        self._latched_ns = None
        return super()._bus_opened(now_ns)


class LateCommandsCount(Supervisor):
    """A command that comes after the deadline, but before anyone looked, saves its leg."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        if isinstance(event, Command) and self._rejection(event) is None:
            for servo_id, _ in event.targets:
                self.legs.by_number[servo_id // 10].heard_ns = now_ns
        return super().step(event, now_ns, instant_ns)


class RejectedCommandsFeed(Supervisor):
    """A rejected command counts as heard."""

    def _command(self, command: Command, now_ns: int) -> list[Effect]:
        effects = super()._command(command, now_ns)
        if effects and isinstance(effects[0], Rejected):
            for servo_id, _ in command.targets:
                self.legs.by_number[servo_id // 10].heard_ns = now_ns
        return effects


class OversleepsTheWatchdog(Supervisor):
    """Wakes up a tick late."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        effects = super().step(event, now_ns, instant_ns)
        self.due_ns = None if self.due_ns is None else self.due_ns + 1
        return effects


class EmergencyStopAfterSlots(Supervisor):
    """An emergency stop comes after the frames whose rate slot has come."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        moves = self.legs.take_slots(now_ns) if self._bus_ok else []
        return moves + super()._emergency_stop(event, now_ns)


class ResetInTheSameInstant(Supervisor):
    """A reset leaves an emergency stop of the same instant, which may be the newer of the two."""

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        self.legs.instant_ns += 1
        return super()._reset(event, now_ns)


class RecoversWithoutStops(Supervisor):
    """After a fault the bus is used at once."""

    def _bus_opened(self, now_ns: int) -> list[Effect]:
        effects = super()._bus_opened(now_ns)
        return [effect for effect in effects if getattr(effect, "cause", None) is not Cause.STARTUP]


class BelievesInStopsFromOutside(Supervisor):
    """All count as stopped, and one that was started after its Stop from outside runs on."""

    def _outside(self, event: StoppedOutside, now_ns: int) -> list[Effect]:
        effects = super()._outside(event, now_ns)
        return [effect for effect in effects if getattr(effect, "cause", None) is not Cause.REPEAT]


class StartsBesideStopServos(Supervisor):
    """A start is taken that a Stop from outside undoes, unseen."""

    def _outside(self, event: StoppedOutside, now_ns: int) -> list[Effect]:
        effects = super()._outside(event, now_ns)
        self.stopped_outside = False
        return effects


class OneSilentLegOnly(Supervisor):
    """The scope of the watchdog is a setting that is accepted and ignored."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        self._rules = replace(rules, whole_robot=False)


class NoPause(StartQueue):
    """The pause between two legs that are energised is accepted and ignored."""

    def started(self, leg: int, now_ns: int) -> None:
        super().started(leg, now_ns)
        self.next_ns = now_ns


class AllAtOnce(Legs):
    """See NoPause."""

    def __init__(self, rules: Rules, reach: Reach) -> None:
        super().__init__(rules, reach)
        self._queue = NoPause(rules.start_pause_ns)
