"""Supervisors with a bug each, for the model check to find: one at least for each of the oracle's sentences.

A bug is planted from outside where it can be: a setting that is ignored, an event that is taken for another one,
effects that are lost or made up. What the supervisor's own lines may do wrong, tests/mutants plants by machine.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from gateway.model.angle_limits import AngleLimits
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import MAX_ANGLE_CDEG
from gateway.robot.core.body_limits import BodyLimits
from gateway.robot.core.calibrating import Calibrating
from gateway.robot.core.events import (
    Calibrate,
    Command,
    Effect,
    Event,
    PowerSeen,
    Targets,
    TimePassed,
    Transmit,
)
from gateway.robot.core.leg import Leg, Rules, Servo
from gateway.robot.core.legs import Legs
from gateway.robot.core.pacing import RateSlots
from gateway.robot.core.power import SILENT
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Reason

Make = Callable[[Rules], Supervisor]


def changed(
    taken: Callable[[Supervisor, Event], Event],
    wanted: Callable[[Supervisor, Event, list[Effect]], list[Effect]],
) -> Make:
    """A supervisor that takes other events than come, or wants other things done."""

    class Changed(Supervisor):
        def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
            return wanted(self, event, super().step(taken(self, event), now_ns, instant_ns))

    return Changed


def ignoring(**settings: Any) -> Make:
    """These settings are accepted, and others used."""
    return lambda rules: Supervisor(replace(rules, **settings))


def taking(kind: type[Event], taken: Callable[[Supervisor, Any], Event]) -> Make:
    """Events of this kind are taken for others."""

    def take(robot: Supervisor, event: Event) -> Event:
        return taken(robot, event) if isinstance(event, kind) else event

    return changed(take, lambda _, __, effects: effects)


def wanting(wanted: Callable[[Supervisor, Event, list[Effect]], list[Effect]]) -> Make:
    """Other effects come of an event."""
    return changed(lambda _, event: event, wanted)


def losing(**named: Any) -> Make:
    """Effects are lost that have all of these."""

    def lost(effect: Effect) -> bool:
        return all(getattr(effect, name, None) == value for name, value in named.items())

    return wanting(lambda _, __, effects: [effect for effect in effects if not lost(effect)])


def without_stops(kind: type[Event]) -> Make:
    """The Stops that come of these events are lost."""
    return wanting(
        lambda _, event, effects: [each for each in effects if not (isinstance(event, kind) and is_stop(each))]
    )


def answering(kind: type[Effect], **changes: Any) -> Make:
    """Effects of this kind are changed."""

    return wanting(
        lambda _, __, effects: [replace(each, **changes) if isinstance(each, kind) else each for each in effects]
    )


def making_up(effect: Effect, *, where: Callable[[Supervisor], bool] = lambda robot: robot._bus_ok) -> Make:
    """An effect comes of nothing but time."""
    return wanting(
        lambda robot, event, effects: [effect, *effects] if isinstance(event, TimePassed) and where(robot) else effects
    )


def showing(part: str, **wrong: Any) -> Make:
    """A part of the supervisor says something else of itself."""

    def show(robot: Supervisor, _: Event, effects: list[Effect]) -> list[Effect]:
        for name, value in wrong.items():
            setattr(getattr(robot, part), name, value)
        return effects

    return wanting(show)


def made_of(
    *,
    slots: type[RateSlots] = RateSlots,
    legs: type[Legs] = Legs,
    reach: type[AngleLimits] = AngleLimits,
    calibrating: type[Calibrating] = Calibrating,
) -> Make:
    """A supervisor of other parts."""

    def make(rules: Rules) -> Supervisor:
        robot = Supervisor(rules)
        robot._reach = reach(rules.joint_limits_cdeg, rules.landing_cdeg, rules.avoid_cdeg)
        robot.calibrating = calibrating(robot._reach)
        robot.legs = legs(rules, robot._reach)
        for leg in robot.legs:
            robot.legs.by_number[leg.number] = Leg(leg.number, leg.servos, slots(rules.period_ns))
        return robot

    return make


def is_stop(effect: Effect) -> bool:
    """Whether a frame stops all that it names."""
    return isinstance(effect, Transmit) and effect.frame.is_stop


# ---- the supervisor itself


class InstantsOfTheirOwn(Supervisor):
    """What was collected together is taken for ordered, as soon as dealing with it takes time."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        del instant_ns
        return super().step(event, now_ns)


class CountsOnlyTheFirst(Supervisor):
    """Later requests of an emergency stop are not numbered."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        effects = super().step(event, now_ns, instant_ns)
        self.estops = min(self.estops, 1)
        return effects


class LatchLostInFault(Supervisor):
    """A bus fault loses the emergency stop."""

    def _bus_opened(self, now_ns: int) -> list[Effect]:
        self._latched_ns = None
        return super()._bus_opened(now_ns)


class OversleepsTheWatchdog(Supervisor):
    """Wakes up a tick late."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        effects = super().step(event, now_ns, instant_ns)
        self.due_ns = None if self.due_ns is None else self.due_ns + 1
        return effects


class WakesUpForLegsOnly(Supervisor):
    """Neither for the lease nor for the buttons."""

    def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
        effects = super().step(event, now_ns, instant_ns)
        self.due_ns = self.legs.due_ns if self._bus_ok else None
        return effects


class StopsNeedPermission(Supervisor):
    """Nobody but its driver can stop the robot, and nobody at all while no button is alive."""

    def _rejection(self, command: Command) -> tuple[Reason, str] | None:
        return super()._rejection(command) or self.lease.rejection(command.lease) or self._why_unwatched()


class FitForAnything(Supervisor):
    """Neither an empty battery nor a fall keeps anything from starting."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        self.body = StartsAlways(rules)


class FeedsInItsSleep(Supervisor):
    """Whatever the power board says keeps nothing from starting."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(replace(rules, power=False))

    def _power_seen(self, event: PowerSeen, now_ns: int) -> list[Effect]:
        effects = super()._power_seen(event, now_ns)
        self.power.closed = False
        return effects


class SilenceStopsOneLeg(Supervisor):
    """The watchdog stops the silent leg alone, where legs only stop together."""

    def _expire(self, now_ns: int) -> list[Effect]:
        rules = self._rules
        self._rules = replace(rules, starts_whole=False)
        effects = super()._expire(now_ns)
        self._rules = rules
        return effects


class AnybodyCalibrates(Supervisor):
    """A change needs no lease, and no mode in which it may be made."""

    def _calibrate(self, event: Calibrate, now_ns: int) -> list[Effect]:
        del now_ns
        return self.calibrating.change(event, self.legs.servos)


class DoubtsBesideTheWatchdog(Supervisor):
    """What was due is dealt with before all is stopped, so that a leg gets two Stops."""

    def _stops_all(self, event: Event) -> bool:
        return not isinstance(event, PowerSeen) and super()._stops_all(event)


class RunsOnWithoutBoard(Supervisor):
    """What runs when the board falls silent goes on."""

    def _bring_down(self, why: str, since_ns: int, now_ns: int, reason: Reason, detail: str) -> list[Effect]:
        return [] if why == SILENT else super()._bring_down(why, since_ns, now_ns, reason, detail)


class LosesOneLeg(Supervisor):
    """A servo that is not fed any more stops its leg, where legs only stop together."""

    def _power_seen(self, event: PowerSeen, now_ns: int) -> list[Effect]:
        rules = self._rules
        self._rules = replace(rules, starts_whole=False)
        effects = super()._power_seen(event, now_ns)
        self._rules = rules
        return effects


class StartsWhatWaitsForABlock(Supervisor):
    """A start that was accepted is sent, though the board has blocked its servo since."""

    def _power_seen(self, event: PowerSeen, now_ns: int) -> list[Effect]:
        effects = super()._power_seen(replace(event, refused=()), now_ns)
        self.power.note(event)
        return effects


# ---- its parts


class StartsAlways(BodyLimits):
    """What is measured forbids nothing."""

    def rejection(self, moves: Targets, servos: Mapping[int, Servo]) -> None:
        del moves, servos


class StartsByLeg(Legs):
    """Starts a part of a robot that starts as a whole."""

    def why_not_whole(self, command: Command) -> None:
        del command


class StartsInItsOwnSlot(Legs):
    """A start does not wait for the last leg's rate slot."""

    def _slot_ns(self, leg: Leg) -> int:
        return leg.slots.next_ns


class StopsByServo(Legs):
    """A Stop stops what it names, also where all is one."""

    def _stop_whole(self, command: Command) -> dict[int, Targets]:
        return command.by_leg


class Bursts(RateSlots):
    """What the bucket holds may go out in one instant."""

    def take(self, now_ns: int) -> None:
        super().take(now_ns)
        self.next_ns = self.oldest_ns


class LandsAtOnce(Legs):
    """A landing jumps to its pose."""

    def begin_landing(self, now_ns: int, ends_ns: int, pose_cdeg: Mapping[int, int]) -> list[Effect]:
        effects = super().begin_landing(now_ns, ends_ns, pose_cdeg)
        if self.landing is not None:
            self.landing = self.landing._replace(length_ns=1, period_ns=1)
        return effects


class GoesOnAfterStop(Legs):
    """A Stop does not end the way to the target."""

    def _stopped(self, servo: Servo, now_ns: int) -> None:
        target_cdeg = servo.target_cdeg
        super()._stopped(servo, now_ns)
        servo.target_cdeg = target_cdeg


class CrossesAtOnce(AngleLimits):
    """A way that leads to angles that are never sent goes on behind them at once."""

    def near_side(self, servo_id: int, from_cdeg: int, angle_cdeg: int) -> int:
        near_cdeg = super().near_side(servo_id, from_cdeg, angle_cdeg)
        if near_cdeg == angle_cdeg:
            return angle_cdeg
        return super().near_side(servo_id, MAX_ANGLE_CDEG if from_cdeg < angle_cdeg else 0, angle_cdeg)


class FramesAsCommanded(AngleLimits):
    """Users' angles go on the wire."""

    def use(self, calibration: RobotCalibration) -> None:
        super().use(calibration)
        self.wire = None


class AnyAngle(AngleLimits):
    """The calibration's limits are not looked at."""

    def use(self, calibration: RobotCalibration) -> None:
        super().use(calibration)
        self.limited = False


class LandsWhereTheSettingsSay(AngleLimits):
    """The pose that a person recorded is not approached."""

    def landing_cdeg(self) -> dict[int, int]:
        return dict(self._landing_cdeg)


class ChangesWhatRuns(Calibrating):
    """A running servo gets another trim, and jumps at its next frame."""

    def change(self, event: Calibrate, servos: Mapping[int, Servo]) -> list[Effect]:
        return super().change(event, {servo_id: Servo(servo_id, servo.leg) for servo_id, servo in servos.items()})


class StartsUntrusted(Calibrating):
    """A robot whose calibration cannot be read starts by whatever is left of it."""

    def load(self, calibration: RobotCalibration, fault: str | None = None) -> None:
        super().load(calibration, fault)
        self.guards = False
