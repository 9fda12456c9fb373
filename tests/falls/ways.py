"""What the servos are sent after the latest command, for each way of stopping: by the core's own landing and timing.

Seconds count from the latest command. The gateway's own delays (milliseconds) are left out; test_falls.py compares this
with what a real gateway writes.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Final, NamedTuple

from gateway.people.walking import Engine, Velocity
from gateway.robot.core.landing import landing
from gateway.robot.settings import Settings
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from tests.falls.stride import Angles, Moment, velocity
from tests.support.walked import copied
from tests.walking.physics import TICK_S, Sent, angles_of

STOP_SERVOS_S: Final = 0.4
"""From a gateway's death to `stop-servos` (docs/stops.md)."""
BUS_FAULT_S: Final = 3.0
SLACK: Final[Mapping[int, float | None]] = dict.fromkeys(SERVO_IDS)
NS: Final = 1_000_000_000


class Way(NamedTuple):
    """A way of stopping: what is sent when, in order."""

    name: str
    sent: Callable[[Moment, Settings], Iterator[Sent]]


def _emergency_stop(_moment: Moment, _settings: Settings) -> Iterator[Sent]:
    yield 0.0, SLACK


def _robot_watchdog(_moment: Moment, settings: Settings) -> Iterator[Sent]:
    yield settings.watchdog.timeout_ms / 1000, SLACK


def _leg_watchdog(moment: Moment, settings: Settings) -> Iterator[Sent]:
    """One leg hears nothing more, and goes slack; the walker then puts the other feet down and stands still."""
    leg = LEGS[moment.phase % len(LEGS)]
    engine, timeout_s = copied(moment.engine), settings.watchdog.timeout_ms / 1000
    silent = {10 * leg + joint for joint in JOINTS}
    number = 1
    while number * TICK_S < timeout_s:
        yield number * TICK_S, _without(_stepped(engine, velocity(moment.stance)), silent)
        number += 1
    yield timeout_s, dict.fromkeys(silent)
    engine.halt([leg])
    while number * TICK_S < timeout_s + 2.0:
        yield number * TICK_S, _without(_stepped(engine, Velocity()), silent)
        number += 1


def _landing(moment: Moment, settings: Settings) -> Iterator[Sent]:
    yield from landed(moment.angles, settings)


def landed(begin: Angles, settings: Settings) -> Iterator[Sent]:
    """By the core's own function, at the legs' rate."""
    began_ns = round(settings.watchdog.timeout_ms * 1e6)
    length_ns = round(settings.watchdog.landing_ms * 1e6)
    period_ns = round(NS / settings.limits.leg_rate_hz)
    ends = {int(name): angle_deg for name, angle_deg in settings.watchdog.landing.items()}
    ways_cdeg = {
        servo_id: (round(100 * angle_deg), round(100 * ends.get(servo_id, angle_deg)))
        for servo_id, angle_deg in begin.items()
    }
    way = landing(began_ns, began_ns + length_ns, length_ns, period_ns, ways_cdeg)
    now_ns, part_ns = began_ns, 0
    while now_ns < way.ends_ns and part_ns < way.length_ns:
        part_ns = way.next_part_ns(part_ns, now_ns)
        yield now_ns / NS, {servo_id: way.angle_cdeg(servo_id, part_ns) / 100 for servo_id in ways_cdeg}
        now_ns += period_ns
    yield way.ends_ns / NS, SLACK


def _killed(_moment: Moment, _settings: Settings) -> Iterator[Sent]:
    yield STOP_SERVOS_S, SLACK


def _bus_fault(_moment: Moment, _settings: Settings) -> Iterator[Sent]:
    """No Stop reaches the servos, which hold where they are; as soon as the bus answers, all six legs get theirs."""
    yield BUS_FAULT_S, SLACK


def _stepped(engine: Engine, wanted: Velocity) -> Angles:
    engine.step(wanted, TICK_S)
    return angles_of(engine)


def _without(angles: Angles, servos: set[int]) -> Angles:
    return {servo_id: angle_deg for servo_id, angle_deg in angles.items() if servo_id not in servos}


WAYS: Final = (
    Way("emergency stop", _emergency_stop),
    Way("leg watchdog", _leg_watchdog),
    Way("robot watchdog", _robot_watchdog),
    Way("landing", _landing),
    Way("killed, stop-servos", _killed),
    Way("bus fault of 3 s", _bus_fault),
)
