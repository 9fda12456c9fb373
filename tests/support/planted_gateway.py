"""A gateway with one planted mistake: `python -m tests.support.planted_gateway MISTAKE run --sim …`.

`check --stops` has to find each.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from gateway import cli
from gateway.model.frames import OneServo, Op, ServoOp
from gateway.robot import service
from gateway.robot.core.events import Effect, EmergencyStop, Event, Transmit
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor

NS_PER_MS: Final = 1_000_000
Change = Callable[[Supervisor, Event, list[Effect]], list[Effect]]


def _late_watchdog(by_ms: int) -> Callable[[Rules], Supervisor]:
    return lambda rules: Supervisor(replace(rules, timeout_ns=rules.timeout_ns + by_ms * NS_PER_MS))


def _changed(change: Change) -> type[Supervisor]:
    """Return a supervisor that wants other things done."""

    class Changed(Supervisor):
        def step(self, event: Event, now_ns: int, instant_ns: int | None = None) -> list[Effect]:
            return change(self, event, super().step(event, now_ns, instant_ns))

    return Changed


def _five_stops(_robot: Supervisor, event: Event, effects: list[Effect]) -> list[Effect]:
    return effects[1:] if isinstance(event, EmergencyStop) else effects


def _late_stops(_robot: Supervisor, event: Event, effects: list[Effect]) -> list[Effect]:
    time.sleep(0.15 if isinstance(event, EmergencyStop) else 0)
    return effects


def _unlatched(robot: Supervisor, event: Event, effects: list[Effect]) -> list[Effect]:
    if isinstance(event, EmergencyStop):
        robot.latch.since_ns = None
    return effects


def _another_angle(_robot: Supervisor, _event: Event, effects: list[Effect]) -> list[Effect]:
    def wrong(each: Effect) -> Effect:
        if isinstance(each, Transmit) and isinstance(each.frame, OneServo) and not each.frame.is_stop:
            ((servo_id, command),) = each.frame.servos
            return replace(each, frame=OneServo(servo_id, ServoOp(command.op, command.angle_cdeg + 1000)))
        return each

    return [wrong(each) for each in effects]


def _no_start(_robot: Supervisor, _event: Event, effects: list[Effect]) -> list[Effect]:
    return [
        each
        for each in effects
        if not (isinstance(each, Transmit) and any(command.op is not Op.STOP for _, command in each.frame.servos))
    ]


MISTAKES: Final[dict[str, tuple[Callable[[Rules], Supervisor], str]]] = {
    "no watchdog": (_late_watchdog(3_600_000), "silence"),
    "watchdog early by 100 ms": (_late_watchdog(-100), "silence"),
    "emergency stop for five legs": (_changed(_five_stops), "estop"),
    "emergency stop late by 150 ms": (_changed(_late_stops), "estop"),
    "emergency stop not latched": (_changed(_unlatched), "estop"),
    "another angle is written": (_changed(_another_angle), "command"),
    "nothing is written": (_changed(_no_start), "command"),
}
"""What is planted, and the step that has to fail."""


if __name__ == "__main__":
    vars(service)["Supervisor"] = MISTAKES[sys.argv.pop(1)][0]
    cli.main()
