"""A gateway with one planted mistake: `python -m tests.support.planted_gateway MISTAKE run --sim …`.

The drill has to find each.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from gateway import cli
from gateway.robot import service
from gateway.robot.core.events import Announce, Command, Effect, EmergencyStop, Reset, Transmit
from gateway.robot.core.lease import Lease
from gateway.robot.core.leg import Rules
from gateway.robot.core.staleness import Staleness
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.protocol.frames import STOP, OneLeg, OneServo, Op, ServoOp
from schemas.telemetry import Cause, Kind, Reason

NS_PER_MS: Final = 1_000_000


class NoWatchdog(Supervisor):
    """Silence stops nobody."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(replace(rules, timeout_ns=3_600_000 * NS_PER_MS))


class LateWatchdog(Supervisor):
    """The watchdog is 100 ms late."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(replace(rules, timeout_ns=rules.timeout_ns + 100 * NS_PER_MS))


class EarlyWatchdog(Supervisor):
    """The watchdog stops a leg that is not silent yet."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(replace(rules, timeout_ns=rules.timeout_ns - 100 * NS_PER_MS))


class SetEnergises(Supervisor):
    """A Set for a servo that does not run starts it."""

    def _rejection(self, command: Command) -> tuple[Reason, str] | None:
        found = super()._rejection(command)
        return None if found is not None and found[0] is Reason.SERVO_STOPPED else found


class EstopIgnored(Supervisor):
    """An emergency stop is answered, and that is all."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        del event, now_ns
        self.estops += 1
        return []


class EstopStopsFive(Supervisor):
    """An emergency stop forgets a leg."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        effects = super()._emergency_stop(event, now_ns)
        last = next(effect for effect in reversed(effects) if isinstance(effect, Transmit))
        return [effect for effect in effects if effect is not last]


class EstopLate(Supervisor):
    """An emergency stop takes its time."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        time.sleep(0.15)
        return super()._emergency_stop(event, now_ns)


class EstopNotLatched(Supervisor):
    """After an emergency stop, starts are taken as ever."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        effects = super()._emergency_stop(event, now_ns)
        self._latched_ns = None
        return effects


class AnyReset(Supervisor):
    """A reset may name any emergency stop."""

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        return super()._reset(replace(event, estop=self.estops), now_ns)


class MovesAfterReset(Supervisor):
    """A reset lets go on what ran before."""

    def _emergency_stop(self, event: EmergencyStop, now_ns: int) -> list[Effect]:
        self.ran = [(servo.servo_id, servo.angle_cdeg) for servo in self.legs.servos.values() if servo.running]
        return super()._emergency_stop(event, now_ns)

    def _reset(self, event: Reset, now_ns: int) -> list[Effect]:
        effects = super()._reset(event, now_ns)
        starts = [Transmit(OneServo(each, ServoOp(Op.START, angle or 0)), Cause.COMMAND) for each, angle in self.ran]
        return [*starts, *effects]


class WrongAngle(Supervisor):
    """What is written is ten degrees off."""

    def step(self, *arguments: Any) -> list[Effect]:
        return [_turned(effect) for effect in super().step(*arguments)]


class NothingWritten(Supervisor):
    """A command is accepted and not written."""

    def step(self, *arguments: Any) -> list[Effect]:
        effects = super().step(*arguments)
        return [each for each in effects if not (isinstance(each, Transmit) and each.cause is Cause.COMMAND)]


def _turned(effect: Effect) -> Effect:
    if not isinstance(effect, Transmit):
        return effect
    ops = [op if op == STOP else ServoOp(op.op, (op.angle_cdeg + 1000) % 18001) for _, op in effect.frame.servos]
    frame = effect.frame
    wrong = (
        OneServo(frame.servo_id, ops[0]) if isinstance(frame, OneServo) else OneLeg(frame.leg, (ops[0], ops[1], ops[2]))
    )
    return Transmit(wrong, effect.cause, effect.deadline_ns, effect.numbers)


class ButtonIgnored(Supervisor):
    """A button that falls silent stops nobody."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(replace(rules, buttons_timeout_ns=3_600_000 * NS_PER_MS))


class ButtonLate(Supervisor):
    """A button counts for 100 ms too long."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(replace(rules, buttons_timeout_ns=rules.buttons_timeout_ns + 100 * NS_PER_MS))


class ButtonStopsFive(Supervisor):
    """A button that falls silent stops all legs but one."""

    def step(self, *arguments: Any) -> list[Effect]:
        effects = super().step(*arguments)
        fell = any(isinstance(each, Announce) and each.kind is Kind.BUTTON_SILENT for each in effects)
        return effects[1:] if fell else effects


class NobodyWatches(Supervisor):
    """While too few buttons are alive, starts are taken as ever."""

    def _rejection(self, command: Command) -> tuple[Reason, str] | None:
        found = super()._rejection(command)
        return None if found is not None and found[0] is Reason.NO_BUTTON else found


def _old_is_fresh() -> None:
    """What was delayed on the way is taken."""
    Staleness.too_old = lambda *_: None  # type: ignore[method-assign]


def _anybody_drives() -> None:
    """The lease keeps nobody out."""
    Lease.rejection = lambda *_, **__: None  # type: ignore[method-assign]


def _supervisor(planted: type[Supervisor]) -> Callable[[], None]:
    def plant() -> None:
        service.Supervisor = planted  # type: ignore[attr-defined]

    return plant


MISTAKES: Final[dict[str, tuple[Callable[[], None], str]]] = {
    "no watchdog": (_supervisor(NoWatchdog), "silence"),
    "watchdog late by 100 ms": (_supervisor(LateWatchdog), "silence"),
    "watchdog early by 100 ms": (_supervisor(EarlyWatchdog), "silence"),
    "a Set energises": (_supervisor(SetEnergises), "set-while-stopped"),
    "a Set energises after a reset": (_supervisor(SetEnergises), "after-reset"),
    "emergency stop ignored": (_supervisor(EstopIgnored), "estop"),
    "emergency stop for five legs": (_supervisor(EstopStopsFive), "estop"),
    "emergency stop late by 150 ms": (_supervisor(EstopLate), "estop"),
    "emergency stop not latched": (_supervisor(EstopNotLatched), "until-reset"),
    "any reset leaves it": (_supervisor(AnyReset), "until-reset"),
    "a reset lets it move": (_supervisor(MovesAfterReset), "after-reset"),
    "old commands are taken": (_old_is_fresh, "cut-link"),
    "the lease is ignored": (_anybody_drives, "lease"),
    "a silent button stops nobody": (_supervisor(ButtonIgnored), "button"),
    "a button counts too long by 100 ms": (_supervisor(ButtonLate), "button"),
    "a silent button stops five legs": (_supervisor(ButtonStopsFive), "button"),
    "starts need no button": (_supervisor(NobodyWatches), "button"),
    "another angle is written": (_supervisor(WrongAngle), "command"),
    "nothing is written": (_supervisor(NothingWritten), "command"),
}
"""What is planted, and the step of the drill that has to fail."""


if __name__ == "__main__":
    MISTAKES[sys.argv.pop(1)][0]()
    cli.main()
