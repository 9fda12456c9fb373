"""Limits how far one frame may move a servo. Pure.

There are two limits: a servo's own speed (`Rules.max_speed_cdeg_s`), and one for servos that *ease*
(`Rules.takeover_cdeg_s`). A servo eases from another source's first command, or from a start within
`Rules.takeover_known_ns` of its Stop, until it arrives. Its angle is known then, and the new target may be far away.
"""

from collections.abc import Iterable

from gateway.allowance import NS_PER_S
from gateway.model.angle_limits import AngleLimits
from gateway.model.frames import OP_START, SETS, STARTS, ServoOp
from gateway.robot.core.leg import Leg, Rules, Servo


# mutants accepted (Gt_GtE, Step): either sign gives the same angle
def step(
    from_cdeg: int, to_cdeg: int, speed_cdeg_s: int, since_ns: int, now_ns: int, period_ns: int
) -> tuple[int, int]:
    """Return the angle of a frame towards a target, and since when the time counts for the next step.

    A step is at most speed times the time since `since_ns`, and speed times a rate slot. Time beyond a rate slot is
    dropped, since the servo would jump after a stall or a long time without a command.

    Steps are whole hundredths of a degree. Time too short for a hundredth is kept for the next step: otherwise a slow
    servo whose leg gets many frames would never move.
    """
    most_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
    slot_cdeg = -(-speed_cdeg_s * period_ns // NS_PER_S)  # rounded up: at least a hundredth
    way_cdeg = to_cdeg - from_cdeg
    if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):
        return to_cdeg, now_ns
    if most_cdeg > slot_cdeg:
        return from_cdeg + (slot_cdeg if way_cdeg > 0 else -slot_cdeg), now_ns
    used_ns = -(-most_cdeg * NS_PER_S // speed_cdeg_s)  # rounded up: never faster
    return from_cdeg + (most_cdeg if way_cdeg > 0 else -most_cdeg), since_ns + used_ns


class LimitedSpeeds:
    """The steps of servos with a limited speed."""

    def __init__(self, rules: Rules, limits: AngleLimits) -> None:
        self._rules = rules
        self._limits = limits
        self._eases = rules.takeover_cdeg_s > 0

    def take_over(self, leg: Leg, servos: Iterable[Servo], source: str | None, now_ns: int) -> None:
        """Ease these servos, which `source` starts, or sets after another source.

        A start keeps the angle that it begins with, however long it waits for power.
        """
        for servo in servos:
            servo.source = source
            if servo.angle_cdeg is not None:
                if self._eases and not servo.eases:
                    leg.eases = servo.eases = True
                    servo.since_ns = leg.slots.taken_ns
            elif servo.from_cdeg is None:
                servo.from_cdeg = None if servo.stopped is None else self._stood_cdeg(servo, now_ns)
                if servo.from_cdeg is None and self._rules.angles_first and servo.waiting is not None:
                    servo.from_cdeg = servo.waiting.angle_cdeg
                leg.eases = leg.eases or servo.from_cdeg is not None

    def _stood_cdeg(self, servo: Servo, now_ns: int) -> int | None:
        """Return a stopped servo's angle if its Stop was recent and the calibration is the same, else None."""
        if servo.stopped is None or not self._eases:
            return None
        angle_cdeg, stopped_ns, calibration = servo.stopped
        known = calibration is self._limits.calibration and now_ns - stopped_ns <= self._rules.takeover_known_ns
        return angle_cdeg if known else None

    # mutants accepted (Forget): only time is lost
    def in_steps(self, leg: Leg, waiting: list[tuple[Servo, ServoOp]], now_ns: int) -> list[tuple[Servo, ServoOp]]:
        """Return the operations in the frame that leaves now: with a speed limit, steps towards the waiting targets."""
        steps = [(servo, self._step(servo, op, now_ns)) for servo, op in waiting]
        leg.eases = any(servo.eases or servo.from_cdeg is not None for servo in leg.servos)
        if len(waiting) == 2:
            (idle,) = {*leg.servos} - {servo for servo, _ in waiting}
            idle.since_ns = now_ns  # the frame repeats its angle, and the next step counts from here
        return steps

    def _step(self, servo: Servo, op: ServoOp, now_ns: int) -> ServoOp:
        target_cdeg, stands_cdeg = op.angle_cdeg, servo.angle_cdeg
        if stands_cdeg is None:
            stands_cdeg, servo.eases, servo.since_ns = servo.from_cdeg, self._eases, now_ns
        speed_cdeg_s = self._rules.max_speed_cdeg_s.get(servo.servo_id)
        if servo.eases:
            takeover_cdeg_s = self._rules.takeover_cdeg_s
            speed_cdeg_s = min(speed_cdeg_s or takeover_cdeg_s, takeover_cdeg_s)
        if speed_cdeg_s is not None and stands_cdeg is not None:  # else its angle is unknown: no step
            crosses = self._limits.crosses(servo.servo_id, stands_cdeg, target_cdeg)
            from_cdeg = servo.passing_cdeg if crosses and servo.passing_cdeg is not None else stands_cdeg
            at_cdeg, servo.since_ns = step(
                from_cdeg, target_cdeg, speed_cdeg_s, servo.since_ns, now_ns, self._rules.period_ns
            )
            sent_cdeg = self._limits.near_side(servo.servo_id, stands_cdeg, at_cdeg)
            servo.passing_cdeg = None if sent_cdeg == at_cdeg else at_cdeg
            op = (STARTS if op.op is OP_START else SETS)[sent_cdeg]
        servo.eases = servo.eases and op.angle_cdeg != target_cdeg
        return op
