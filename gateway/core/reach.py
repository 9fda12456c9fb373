"""Where servos may go, and what the wire then carries: the settings' joint limits and the calibration in force. Pure.

Both must allow an angle. Each allows one range without gaps, so whatever lies between two angles that were accepted
(a step of a limited speed, a landing's straight line) may be sent as well.
"""

from gateway.core.calibration import Calibration
from gateway.core.leg import Rules


class Reach:
    """What every servo may do. One owner, one thread."""

    def __init__(self, rules: Rules) -> None:
        self._limits_cdeg = rules.joint_limits_cdeg
        self._landing_cdeg = rules.landing_cdeg
        self.use(Calibration())

    def use(self, calibration: Calibration) -> None:
        """From now on this calibration is in force. No servo may run whose frames it changes."""
        self.calibration = calibration
        self.wire = calibration if calibration.servos else None
        """What translates frames; None: they go on the wire as they are, and nothing is spent on it."""
        self.limited = bool(self._limits_cdeg or calibration.servos)
        """Whether `why_not` may have anything against any angle."""

    def why_not(self, servo_id: int, angle_cdeg: int) -> str | None:
        """Why the servo must not go to this angle, as users count it; None: it may."""
        limits = self._limits_cdeg.get(servo_id)
        if limits is not None and not limits[0] <= angle_cdeg <= limits[1]:
            low, high, angle = (cdeg / 100 for cdeg in (*limits, angle_cdeg))
            return f"servo {servo_id} may go from {low:g} to {high:g} degrees; {angle:g} is outside"
        return self.calibration.why_not(servo_id, angle_cdeg)

    def landing_cdeg(self) -> dict[int, int]:
        """The landing pose: the settings', where the calibration has no other; angles that may be gone to, only."""
        pose = {**self._landing_cdeg, **self.calibration.landing_cdeg}
        return {servo_id: angle for servo_id, angle in pose.items() if self.why_not(servo_id, angle) is None}
