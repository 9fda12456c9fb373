"""A gateway with one planted mistake: `python -m tests.support.planted_gateway MISTAKE run --sim …`.

The drill has to find each.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from gateway import cli
from gateway.model.frames import STOP, Frame, OneLeg, OneServo, Op, ServoOp
from gateway.model.staleness import Staleness
from gateway.robot import service
from gateway.robot.core.events import Announce, Command, Effect, EmergencyStop, Event, Reset, Transmit
from gateway.robot.core.lease import RobotLease
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Cause, Kind, Reason

NS_PER_MS: Final = 1_000_000
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


def _later(by_ms: int, of: str = "timeout_ns") -> Make:
    """A silence is noticed later than it is set to."""
    return lambda rules: Supervisor(replace(rules, **{of: getattr(rules, of) + by_ms * NS_PER_MS}))


def _accepting(what: Reason) -> Make:
    """What is to be rejected for this reason is accepted."""

    class Accepting(Supervisor):
        def _rejection(self, command: Command) -> tuple[Reason, str] | None:
            found = super()._rejection(command)
            return None if found is not None and found[0] is what else found

    return Accepting


def _five_stops(_robot: Supervisor, event: Event, effects: list[Effect]) -> list[Effect]:
    """A leg is forgotten by an emergency stop, and by the Stops for a button that falls silent."""
    fell = any(isinstance(each, Announce) and each.kind is Kind.BUTTON_SILENT for each in effects)
    return effects[1:] if isinstance(event, EmergencyStop) or fell else effects


def _late_stops(_robot: Supervisor, event: Event, effects: list[Effect]) -> list[Effect]:
    """An emergency stop takes its time."""
    time.sleep(0.15 if isinstance(event, EmergencyStop) else 0)
    return effects


class EstopIgnored(Supervisor):
    """An emergency stop is answered, and that is all."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        del event, now_ns
        self.estops += 1
        return []


def _unlatched(robot: Supervisor, event: Event, effects: list[Effect]) -> list[Effect]:
    """After an emergency stop, starts are taken as ever."""
    if isinstance(event, EmergencyStop):
        robot._latched_ns = None
    return effects


class MovesAfterReset(Supervisor):
    """A reset lets go on what ran before."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        self.ran = [(servo.servo_id, servo.angle_cdeg) for servo in self.legs.servos.values() if servo.running]
        return super()._emergency_stop(event, now_ns)

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        effects = super()._reset(event, now_ns)
        starts = [Transmit(OneServo(each, ServoOp(Op.START, angle or 0)), Cause.COMMAND) for each, angle in self.ran]
        return [*starts, *effects]


def _any_number(robot: Supervisor, reset: Reset) -> Reset:
    return replace(reset, estop=robot.estops)


def _turned(_robot: Supervisor, _event: Event, effects: list[Effect]) -> list[Effect]:
    """What is written is ten degrees off."""

    def turned(op: ServoOp) -> ServoOp:
        return op if op == STOP else ServoOp(op.op, (op.angle_cdeg + 1000) % 18001)

    def wrong(frame: Frame) -> Frame:
        if isinstance(frame, OneServo):
            return OneServo(frame.servo_id, turned(frame.command))
        first, second, third = (turned(op) for _, op in frame.servos)
        return OneLeg(frame.leg, (first, second, third))

    return [replace(each, frame=wrong(each.frame)) if isinstance(each, Transmit) else each for each in effects]


def _old_is_fresh() -> None:
    """What was delayed on the way is taken."""
    Staleness.too_old = lambda *_: None  # type: ignore[method-assign]


def _anybody_drives() -> None:
    """The lease keeps nobody out."""
    RobotLease.rejection = lambda *_, **__: None  # type: ignore[method-assign]


def _supervisor(planted: Make) -> Callable[[], None]:
    def plant() -> None:
        vars(service)["Supervisor"] = planted

    return plant


MISTAKES: Final[dict[str, tuple[Callable[[], None], str]]] = {
    "no watchdog": (_supervisor(_later(3_600_000)), "silence"),
    "watchdog late by 100 ms": (_supervisor(_later(100)), "silence"),
    "watchdog early by 100 ms": (_supervisor(_later(-100)), "silence"),
    "a Set energises": (_supervisor(_accepting(Reason.SERVO_STOPPED)), "set-while-stopped"),
    "a Set energises after a reset": (_supervisor(_accepting(Reason.SERVO_STOPPED)), "after-reset"),
    "emergency stop ignored": (_supervisor(EstopIgnored), "estop"),
    "emergency stop for five legs": (_supervisor(wanting(_five_stops)), "estop"),
    "emergency stop late by 150 ms": (_supervisor(wanting(_late_stops)), "estop"),
    "emergency stop not latched": (_supervisor(wanting(_unlatched)), "until-reset"),
    "any reset leaves it": (_supervisor(taking(Reset, _any_number)), "until-reset"),
    "a reset lets it move": (_supervisor(MovesAfterReset), "after-reset"),
    "old commands are taken": (_old_is_fresh, "cut-link"),
    "the lease is ignored": (_anybody_drives, "lease"),
    "a silent button stops nobody": (_supervisor(_later(3_600_000, "buttons_timeout_ns")), "button"),
    "a button counts too long by 100 ms": (_supervisor(_later(100, "buttons_timeout_ns")), "button"),
    "a silent button stops five legs": (_supervisor(wanting(_five_stops)), "button"),
    "starts need no button": (_supervisor(_accepting(Reason.NO_BUTTON)), "button"),
    "another angle is written": (_supervisor(wanting(_turned)), "command"),
    "nothing is written": (_supervisor(losing(cause=Cause.COMMAND)), "command"),
}
"""What is planted, and the step of the drill that has to fail."""


if __name__ == "__main__":
    MISTAKES[sys.argv.pop(1)][0]()
    cli.main()
