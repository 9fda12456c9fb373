"""How far a servo may go with one frame, where its speed is limited. Pure."""

from typing import NamedTuple

from gateway.allowance import NS_PER_S
from gateway.model.angle_limits import AngleLimits
from gateway.model.frames import OP_STOP, SETS, ServoOp
from gateway.robot.core.leg import NO_COMMAND, Leg, Rules, Servo


class Step(NamedTuple):
    """What a frame may say, and from when on the next one counts."""

    angle_cdeg: int
    since_ns: int


def step(from_cdeg: int, to_cdeg: int, speed_cdeg_s: int, since_ns: int, now_ns: int, period_ns: int) -> Step:
    """One step from an angle towards another, at most speed times time since `since_ns`, and speed times a rate slot.

    Time beyond a rate slot is lost: after a stall, or after a long time without a command, a servo would else leap.

    Whole hundredths of a degree only. The time that a hundredth took counts as used, and the rest is left for the next
    step: else a slow servo whose leg gets many frames would never move.
    """
    most_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
    slot_cdeg = -(-speed_cdeg_s * period_ns // NS_PER_S)  # rounded up: at least a hundredth
    way_cdeg = to_cdeg - from_cdeg
    if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):
        return Step(to_cdeg, now_ns)
    if most_cdeg > slot_cdeg:
        return Step(from_cdeg + (slot_cdeg if way_cdeg > 0 else -slot_cdeg), now_ns)
    used_ns = -(-most_cdeg * NS_PER_S // speed_cdeg_s)  # rounded up: never faster, by no nanosecond
    return Step(from_cdeg + (most_cdeg if way_cdeg > 0 else -most_cdeg), since_ns + used_ns)


class LimitedSpeeds:
    """Steps of servos whose speed is limited."""

    def __init__(self, rules: Rules, reach: AngleLimits) -> None:
        self._rules = rules
        self._reach = reach

    def in_steps(self, leg: Leg, now_ns: int) -> list[tuple[Servo, ServoOp]]:
        """What the frame that goes out now says, where speeds are limited: for each servo a step towards its target."""
        said: list[tuple[Servo, ServoOp]] = []
        for servo in leg.servos:
            if servo.waiting is None and servo.target_cdeg is not None:
                servo.waiting, servo.waiting_for = SETS[servo.target_cdeg], NO_COMMAND
            if servo.waiting is None:
                continue
            speed_cdeg_s = self._rules.max_speed_cdeg_s.get(servo.servo_id)
            if servo.waiting.op is not OP_STOP:
                target_cdeg, servo.target_cdeg = servo.waiting.angle_cdeg, None
                stands_cdeg = servo.angle_cdeg
                if stands_cdeg is None and self._rules.angles_first:
                    stands_cdeg, servo.since_ns = servo.announced_cdeg, now_ns
                if speed_cdeg_s is None or stands_cdeg is None:
                    servo.since_ns = now_ns  # a servo that does not run may be anywhere, so its start is no step
                else:
                    angle_cdeg = self._step(servo, stands_cdeg, target_cdeg, speed_cdeg_s, now_ns)
                    servo.waiting = ServoOp(servo.waiting.op, angle_cdeg)
                    servo.target_cdeg = None if angle_cdeg == target_cdeg else target_cdeg
                    if servo.waiting_for is not NO_COMMAND:
                        servo.target_for = servo.waiting_for
            said.append((servo, servo.waiting))
        if len(said) > 1:
            for servo in leg.servos:
                if servo.waiting is None:
                    servo.since_ns = now_ns  # the frame repeats its angle, and the next step counts from here
        return said

    def _step(self, servo: Servo, stands_cdeg: int, target_cdeg: int, speed_cdeg_s: int, now_ns: int) -> int:
        """Where the next frame takes a running servo whose speed is limited."""
        crosses = self._reach.crosses(servo.servo_id, stands_cdeg, target_cdeg)
        from_cdeg = servo.passing_cdeg if crosses and servo.passing_cdeg is not None else stands_cdeg
        at_cdeg, servo.since_ns = step(
            from_cdeg, target_cdeg, speed_cdeg_s, servo.since_ns, now_ns, self._rules.period_ns
        )
        sent_cdeg = self._reach.near_side(servo.servo_id, stands_cdeg, at_cdeg)
        servo.passing_cdeg = None if sent_cdeg == at_cdeg else at_cdeg
        return sent_cdeg
