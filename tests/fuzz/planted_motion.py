"""Limited speeds and landings with a bug each, for the model check to find."""

from collections.abc import Mapping

from gateway.robot.core.calibrating import Calibrating
from gateway.robot.core.events import Effect
from gateway.robot.core.joint_limits import Reach
from gateway.robot.core.leg import NO_COMMAND, Leg, Rules, Servo
from gateway.robot.core.legs import Legs
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.protocol.frames import MAX_ANGLE_CDEG, ServoOp
from schemas.telemetry import Cause, Reason


class LandingWithoutEnd(Supervisor):
    """A landing goes on for as long as nobody stops it."""

    def _touch_down(self, ends_ns: int, now_ns: int) -> list[Effect]:
        del ends_ns, now_ns
        return []


class LandingMadeLonger(Supervisor):
    """A leg that falls silent meanwhile makes the landing begin anew."""

    def _touch_down(self, ends_ns: int, now_ns: int) -> list[Effect]:
        del ends_ns
        silent = [leg for leg in self.legs if leg.heard_ns and now_ns == leg.heard_ns + self._rules.timeout_ns]
        return self._begin_landing("", now_ns + self._rules.landing_ns, now_ns) if silent else []


class CommandsDuringLanding(Supervisor):
    """A laptop that is back moves its leg in the middle of a landing."""

    def _why_closed(self, lease: str | None) -> tuple[Reason, str] | None:
        found = super()._why_closed(lease)
        return None if found is not None and found[0] is Reason.LANDING else found


class LandsAfterEmergencyStop(Supervisor):
    """An emergency stop does not end the landing."""

    def _stop_all(self, cause: Cause, now_ns: int, reason: Reason, detail: str) -> list[Effect]:
        landing = self.legs.landing
        effects = super()._stop_all(cause, now_ns, reason, detail)
        for servo_id in landing.ways_cdeg if landing is not None else ():
            self.legs.servos[servo_id].angle_cdeg = landing.ways_cdeg[servo_id][0] if landing else None
        self.legs.landing = landing
        return effects


class StartsWhileLanding(Legs):
    """What waits to be started is started during the landing."""

    def begin_landing(self, now_ns: int, ends_ns: int, pose_cdeg: Mapping[int, int]) -> list[Effect]:
        waiting = [(servo, servo.waiting) for servo in self.servos.values()]
        effects = super().begin_landing(now_ns, ends_ns, pose_cdeg)
        for servo, target in waiting:
            servo.waiting, servo.waiting_number = target, NO_COMMAND
        return effects


class LandsAtOnce(Legs):
    """A landing jumps to its pose."""

    def begin_landing(self, now_ns: int, ends_ns: int, pose_cdeg: Mapping[int, int]) -> list[Effect]:
        effects = super().begin_landing(now_ns, ends_ns, pose_cdeg)
        if self.landing is not None:
            self.landing = self.landing._replace(length_ns=1, period_ns=1)
        return effects


class MakesUpForAStall(Legs):
    """After a stall, a landing leaps to where it would be."""

    def begin_landing(self, now_ns: int, ends_ns: int, pose_cdeg: Mapping[int, int]) -> list[Effect]:
        effects = super().begin_landing(now_ns, ends_ns, pose_cdeg)
        if self.landing is not None:
            self.landing = self.landing._replace(period_ns=ends_ns)
        return effects


class LandsFasterWhereItIsLate(Legs):
    """A landing that begins late is in time all the same."""

    def begin_landing(self, now_ns: int, ends_ns: int, pose_cdeg: Mapping[int, int]) -> list[Effect]:
        effects = super().begin_landing(now_ns, ends_ns, pose_cdeg)
        if self.landing is not None:
            length_ns = max(1, ends_ns - now_ns - 2 * self.landing.period_ns)
            self.landing = self.landing._replace(length_ns=length_ns)
        return effects


class SendsWhatIsAvoided(Reach):
    """A way leads through angles that are never sent."""

    def near_side(self, servo_id: int, from_cdeg: int, angle_cdeg: int) -> int:
        del servo_id, from_cdeg
        return angle_cdeg


class CrossesAtOnce(Reach):
    """A way that leads to angles that are never sent goes on behind them at once."""

    def near_side(self, servo_id: int, from_cdeg: int, angle_cdeg: int) -> int:
        near_cdeg = super().near_side(servo_id, from_cdeg, angle_cdeg)
        if near_cdeg == angle_cdeg:
            return angle_cdeg
        return super().near_side(servo_id, MAX_ANGLE_CDEG if from_cdeg < angle_cdeg else 0, angle_cdeg)


def avoiding(reach: type[Reach]) -> type[Supervisor]:
    """A supervisor with another reach."""

    class Planted(Supervisor):
        def __init__(self, rules: Rules) -> None:
            super().__init__(rules)
            self._reach = reach(rules)
            self.calibrating = Calibrating(self._reach)
            self.legs = Legs(rules, self._reach)

    return Planted


class Jumps(Legs):
    """A servo whose speed is limited goes to its target at once."""

    def _in_steps(self, leg: Leg, now_ns: int) -> list[tuple[Servo, ServoOp]]:
        del now_ns
        return [(servo, servo.waiting) for servo in leg.servos if servo.waiting is not None]


class TakesOneStep(Legs):
    """A servo whose speed is limited takes one step for each command, and never comes to its target."""

    def _in_steps(self, leg: Leg, now_ns: int) -> list[tuple[Servo, ServoOp]]:
        said = super()._in_steps(leg, now_ns)
        for servo in leg.servos:
            servo.target_cdeg = None
        return said


class TimeCountsTwice(Legs):
    """A frame that tells a servo its angle again does not count as its last frame, nor does a step."""

    def _in_steps(self, leg: Leg, now_ns: int) -> list[tuple[Servo, ServoOp]]:
        since = [(servo, servo.since_ns) for servo in leg.servos if servo.running]
        said = super()._in_steps(leg, now_ns)
        for servo, since_ns in since:
            servo.since_ns = since_ns
        return said


class GoesOnAfterStop(Legs):
    """A Stop does not end the way to the target."""

    def _stopped(self, servo: Servo, now_ns: int) -> None:
        target_cdeg = servo.target_cdeg
        super()._stopped(servo, now_ns)
        servo.target_cdeg = target_cdeg
