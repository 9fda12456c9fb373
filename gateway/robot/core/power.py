"""The starts that the power board's answers allow, and the servos that it is to feed. Pure.

One rule for both wires: a servo is fed while it runs or waits to be started, and at no other time. Its start leaves
once the board has confirmed that it is fed. A servo that is not fed does not count as running: fed again, it would jump
to its angle. So a servo that the board no longer feeds is stopped on the wire as well.
"""

from collections.abc import Collection, Iterable

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OP_START, STARTS, OneServo
from gateway.robot.core.leg import Leg, Rules, Servo


def starts(servo: Servo) -> bool:
    """Return whether a start of this servo waits."""
    return servo.angle_cdeg is None and servo.waiting is not None and servo.waiting.op is OP_START


def held_starts(leg: Leg, servos: Iterable[Servo], fed: Collection[int] | None) -> list[Servo]:
    """Return the servos of a leg whose starts wait for supply: those of a command that starts a servo of `servos` that
    the board does not feed. So a command starts all its servos at once, or none. `fed` None: there is no board."""
    if fed is None:
        return []
    unfed = [each.waiting_for for each in servos if starts(each) and each.servo_id not in fed]
    return [each for each in leg.servos if starts(each) and each.waiting_for in unfed] if unfed else []


def note_supply(leg: Leg, held: list[Servo], now_ns: int, watched_ns: int, rules: Rules) -> tuple[int, bool]:
    """Record since when a leg waits for supply. Return its deadline (ns), and whether a target of it waits only for its
    rate slot.

    `held`: its starts that wait for supply. `watched_ns`: when the watchdog stops it; NEVER if none of it runs.
    """
    under_way = sum(each.waiting is not None or each.target_cdeg is not None for each in leg.servos)
    if not held:
        leg.unfed_ns = None
        due = leg.armed and leg.commanded_ns is not None
        return (leg.commanded_ns or 0) + rules.timeout_ns if due else watched_ns, under_way > 0
    leg.unfed_ns = now_ns if leg.unfed_ns is None else leg.unfed_ns
    return min(watched_ns, leg.unfed_ns + rules.feed_ns), under_way > len(held)


def unfed_since(legs: Iterable[Leg], ns: int) -> list[int]:
    """Return the legs with a start that has waited for its supply since `ns` or longer."""
    return [leg.number for leg in legs if leg.unfed_ns is not None and leg.unfed_ns <= ns]


def servos_to_feed(servos: Iterable[Servo], wire: RobotCalibration | None) -> dict[int, int | None]:
    """Return the servos that are to be fed: those that run (None), and those that wait to be started, each with the
    wire's angle (hundredths of a degree) at which supply would start it.

    That angle stays the same while the start waits, whatever is set meanwhile.
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
