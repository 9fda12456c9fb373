"""Decides which starts the power board's answers allow, and which servos to power. Pure.

With either wire, a servo is powered only while it runs or waits to be started. Its start leaves once the board has
confirmed its power. A servo without power is stopped on the wire, too: with power again, it would jump to its angle.
"""

from collections.abc import Collection, Iterable

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OP_START, STARTS, OneServo
from gateway.robot.core.leg import Leg, Rules, Servo


def starts(servo: Servo) -> bool:
    """Return whether a start of this servo waits."""
    return servo.angle_cdeg is None and servo.waiting is not None and servo.waiting.op is OP_START


def held_starts(leg: Leg, servos: Iterable[Servo], fed: Collection[int] | None) -> list[Servo]:
    """Return the leg's servos whose starts wait for power. A command starts all its servos at once, or none: its starts
    wait while one of its servos in `servos` has no power. `fed` None: there is no board."""
    if fed is None:
        return []
    unfed = [each.waiting_for for each in servos if starts(each) and each.servo_id not in fed]
    return [each for each in leg.servos if starts(each) and each.waiting_for in unfed] if unfed else []


def note_supply(leg: Leg, held: list[Servo], now_ns: int, watched_ns: int, rules: Rules) -> tuple[int, bool]:
    """Record since when a leg waits for power. Return its deadline (ns), and whether another target waits for its slot.

    `held` are its starts that wait for power. `watched_ns` is when the watchdog stops it (NEVER: no servo runs).
    """
    under_way = sum(each.waiting is not None or each.target_cdeg is not None for each in leg.servos)
    if not held:
        leg.unfed_ns = None
        due = leg.armed and leg.commanded_ns is not None
        return (leg.commanded_ns or 0) + rules.timeout_ns if due else watched_ns, under_way > 0
    leg.unfed_ns = now_ns if leg.unfed_ns is None else leg.unfed_ns
    return min(watched_ns, leg.unfed_ns + rules.feed_ns), under_way > len(held)


def unfed_since(legs: Iterable[Leg], ns: int) -> list[int]:
    """Return the legs with a start that has waited for power since `ns` or longer."""
    return [leg.number for leg in legs if leg.unfed_ns is not None and leg.unfed_ns <= ns]


def servos_to_feed(servos: Iterable[Servo], wire: RobotCalibration | None) -> dict[int, int | None]:
    """Return the servos to power: running ones (None), and waiting starts with their wire angle in hundredths of 1°.

    Supply may start a servo at this angle, so it stays the same while the start waits.
    """
    found: dict[int, int | None] = {}
    for servo in servos:
        if servo.angle_cdeg is not None:
            found[servo.servo_id] = None
        elif servo.waiting is not None and starts(servo):
            if servo.announced_cdeg is None:
                servo.announced_cdeg = servo.waiting.angle_cdeg
            frame = OneServo(servo.servo_id, STARTS[servo.announced_cdeg])
            found[servo.servo_id] = (frame if wire is None else wire.frame(frame)).servos[0][1].angle_cdeg
    return found
