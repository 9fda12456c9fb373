"""How far one frame may move a servo: the least of the limits that apply. Pure.

| limit | applies |
|---|---|
| own speed (`Rules.max_speed_cdeg_s`) | always |
| take-over (`takeover_cdeg_s`) | from another source's first command or a start soon after its Stop, until it arrives |
| landing | so that all servos arrive together, two rate slots before the landing ends |

A stopped servo starts without steps, unless its angle is known.
"""

from gateway.model.angle_limits import AngleLimits
from gateway.model.frames import OP_START, SETS, STARTS, ServoOp
from gateway.rate_limit import NS_PER_S
from gateway.robot.core.leg import Leg
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import RUNNING, Servo


# mutants accepted (Gt_GtE, Step): either sign gives the same angle
def step(
    from_cdeg: int, to_cdeg: int, speed_cdeg_s: int, since_ns: int, now_ns: int, most_cdeg: int, *, late: bool = False
) -> tuple[int, int]:
    """Return the angle of a frame towards a target, and since when the time counts for the next step.

    A step is at most `most_cdeg`, and speed times the time since `since_ns`. Time beyond that is dropped, since the
    servo would jump after a stall or a long time without a command; with `late`, later steps make up for it.

    Steps are whole hundredths of a degree. Time too short for a hundredth is kept for the next step: otherwise a slow
    servo whose leg gets many frames would never move.
    """
    far_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
    way_cdeg = to_cdeg - from_cdeg
    step_cdeg = min(far_cdeg, most_cdeg)
    if abs(way_cdeg) <= step_cdeg:
        return to_cdeg, now_ns
    used_ns = -(-step_cdeg * NS_PER_S // speed_cdeg_s)  # rounded up: never faster
    return from_cdeg + (step_cdeg if way_cdeg > 0 else -step_cdeg), (
        now_ns if far_cdeg > most_cdeg and not late else since_ns + used_ns
    )


class Paces:
    """The steps of servos with a limited speed."""

    def __init__(self, rules: Rules, limits: AngleLimits) -> None:
        self._rules = rules
        self._limits = limits
        self._own_cdeg_s = rules.max_speed_cdeg_s

    # ---- what limits a servo

    def take_over(self, leg: Leg, servo: Servo) -> None:
        """Ease a running servo that another source is about to set."""
        if self._rules.takeover_cdeg_s and servo.life is RUNNING and servo.pace_cdeg_s is None:
            servo.ease(self._rules.takeover_cdeg_s, leg.slots.taken_ns)

    def begin_cdeg(self, servo: Servo, op: ServoOp, now_ns: int) -> int | None:
        """Return where the start `op` of a stopped servo begins; None: at its target.

        It begins where the servo was stopped, if that was recent and the calibration is the same.
        """
        if servo.known is not None and self._rules.takeover_cdeg_s:
            angle_cdeg, stopped_ns, calibration = servo.known
            if calibration == self._limits.calibration and now_ns - stopped_ns <= self._rules.takeover_known_ns:
                return angle_cdeg
        return op.angle_cdeg if self._rules.angles_first else None

    def land(self, servo: Servo, angle_cdeg: int, now_ns: int) -> None:
        """Let a running servo go to its landing angle at constant speed."""
        length_ns = max(self._rules.period_ns, self._rules.landing_ns - 2 * self._rules.period_ns)
        stands_cdeg = servo.angle_cdeg
        if stands_cdeg is not None and stands_cdeg != angle_cdeg:
            servo.land(angle_cdeg, -(-abs(angle_cdeg - stands_cdeg) * NS_PER_S // length_ns), now_ns)

    # ---- its steps

    def step(self, servo: Servo, now_ns: int, before_ns: int, *, lands: bool) -> ServoOp:
        """Return the operation in the frame that leaves now, which the servo records: its target, or a step.

        The leg's frame before left at `before_ns`. `lands`: the robot lands, and has a time in which to arrive, so a
        late timer does not make it slower.
        """
        own_cdeg_s, period_ns = self._own_cdeg_s.get(servo.servo_id), self._rules.period_ns
        if servo.life is RUNNING and servo.pace_cdeg_s is None and own_cdeg_s is None:
            return servo.wrote_target(now_ns)
        stands_cdeg, since_ns, target = servo.angle_cdeg, servo.since_ns, servo.newest
        if stands_cdeg is None:
            stands_cdeg, since_ns = servo.from_cdeg, now_ns
            if stands_cdeg is not None and self._rules.takeover_cdeg_s:
                servo.ease(self._rules.takeover_cdeg_s, now_ns)
        speed_cdeg_s = min((each for each in (own_cdeg_s, servo.pace_cdeg_s) if each), default=None)
        if stands_cdeg is None or speed_cdeg_s is None:  # without its angle there is no step
            return servo.wrote_target(now_ns)
        most_cdeg = -(-speed_cdeg_s * period_ns // NS_PER_S)  # a rate slot's, rounded up: at least a hundredth
        if lands and own_cdeg_s is not None:  # what it makes up for has this limit, too
            most_cdeg = min(most_cdeg, own_cdeg_s * (now_ns - before_ns) // NS_PER_S)
        crosses = self._limits.crosses(servo.servo_id, stands_cdeg, target.angle_cdeg)
        from_cdeg = servo.passing_cdeg if crosses and servo.passing_cdeg is not None else stands_cdeg
        at_cdeg, since_ns = step(from_cdeg, target.angle_cdeg, speed_cdeg_s, since_ns, now_ns, most_cdeg, late=lands)
        sent_cdeg = self._limits.near_side(servo.servo_id, stands_cdeg, at_cdeg)
        op = (STARTS if target.op is OP_START else SETS)[sent_cdeg]
        servo.wrote_step(op, since_ns, None if sent_cdeg == at_cdeg else at_cdeg)
        return op
