"""The angles that servos may take: the settings' joint limits and the calibration in force. Pure.

Both must allow an angle. Each allows one range without gaps, so every angle between two accepted ones may be sent, too
(a step of a limited speed, a landing's straight line). Wire angles that are never sent (`Framing.avoid_cdeg`) are a
gap: a motion across it waits at the near end until it would be at the far end.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import MAX_ANGLE_CDEG, ServoOp
from schemas.robot import SERVO_IDS

_WHY_AVOIDED: Final = (
    "are never sent: where one byte is lost, the published firmware dies of whole degrees 1 to 3, with its servos on"
)


@dataclass(eq=False)
class AngleLimits:
    """The allowed angles of every servo, in hundredths of a degree. One owner, one thread."""

    of_settings: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    """The settings' limits by servo, in users' angles."""
    pose_of_settings: Mapping[int, int] = field(default_factory=dict)
    """The settings' landing pose, in users' angles."""
    avoid_cdeg: tuple[int, int] | None = None
    """Wire angles that are never sent, the second one not included."""

    def __post_init__(self) -> None:
        self.use(RobotCalibration())

    def use(self, calibration: RobotCalibration) -> None:
        """Put this calibration in force. No servo whose frames it changes may run."""
        self.calibration = calibration
        self.wire = calibration if calibration.servos else None
        """Converts frames for the wire; None: they need no conversion."""
        self.limited = bool(self.of_settings or calibration.servos or self.avoid_cdeg)
        """Whether `why_not` may reject any angle."""
        self.free_cdeg = {servo_id: self._free(servo_id) for servo_id in SERVO_IDS}

    def _free(self, servo_id: int) -> tuple[int, int]:
        """Return a range of a servo's users' angles that are all allowed: most setpoints need no other check."""
        servo, (low, high) = self.calibration.of(servo_id), self.of_settings.get(servo_id, (0, MAX_ANGLE_CDEG))
        least_cdeg = 0 if self.avoid_cdeg is None else self.avoid_cdeg[1]
        ends = sorted(map(servo.user_cdeg, (least_cdeg, MAX_ANGLE_CDEG)))
        return max(low, servo.min_cdeg, ends[0]), min(high, servo.max_cdeg, ends[1])

    def are_free(self, targets: Iterable[tuple[int, ServoOp]]) -> bool:
        """Return whether all servos may go to these angles, and none needs a further check."""
        for servo_id, op in targets:
            low_cdeg, high_cdeg = self.free_cdeg[servo_id]
            if not low_cdeg <= op.angle_cdeg <= high_cdeg:
                return False
        return True

    def why_not(self, servo_id: int, angle_cdeg: int) -> str | None:
        """Return why the servo must not go to this user's angle (hundredths of a degree), or None if it may."""
        free = self.free_cdeg[servo_id]
        if free[0] <= angle_cdeg <= free[1]:
            return None
        limits = self.of_settings.get(servo_id)
        if limits is not None and not limits[0] <= angle_cdeg <= limits[1]:
            low, high, angle = (cdeg / 100 for cdeg in (*limits, angle_cdeg))
            return f"servo {servo_id} may go from {low:g} to {high:g} degrees; {angle:g} is outside"
        calibration = self.calibration
        return calibration.why_not(servo_id, angle_cdeg) or self.why_avoided(calibration, servo_id, angle_cdeg)

    def why_avoided(self, calibration: RobotCalibration, servo_id: int, angle_cdeg: int) -> str | None:
        """Return why this user's angle is never sent with that calibration, or None if it may be."""
        if self.avoid_cdeg is None:
            return None
        wire_cdeg = calibration.of(servo_id).wire_cdeg(angle_cdeg)
        low, high = self.avoid_cdeg
        if not low <= wire_cdeg < high:
            return None
        angle = f"{angle_cdeg / 100:g} degrees of servo {servo_id}"
        if wire_cdeg != angle_cdeg:
            angle += f" are its own {wire_cdeg / 100:g}, with its calibration"
        return f"{angle}; angles on the wire from {low / 100:g} up to {high / 100:g} {_WHY_AVOIDED}"

    # mutants accepted (Lt_LtE): no way begins at an angle that is never sent
    def crosses(self, servo_id: int, from_cdeg: int, to_cdeg: int) -> bool:
        """Return whether angles that are never sent lie between these two allowed ones."""
        if self.avoid_cdeg is None:
            return False
        servo, low_cdeg = self.calibration.of(servo_id), self.avoid_cdeg[0]
        return (servo.wire_cdeg(from_cdeg) < low_cdeg) is not (servo.wire_cdeg(to_cdeg) < low_cdeg)

    # mutants accepted (Lt_LtE): as in crosses
    def near_side(self, servo_id: int, from_cdeg: int, angle_cdeg: int) -> int:
        """Return the angle to send for a motion from `from_cdeg` that is at `angle_cdeg` now: `angle_cdeg` if it is
        allowed, else the last angle before the gap."""
        if self.avoid_cdeg is None:
            return angle_cdeg
        servo, (low_cdeg, high_cdeg) = self.calibration.of(servo_id), self.avoid_cdeg
        if not low_cdeg <= servo.wire_cdeg(angle_cdeg) < high_cdeg:
            return angle_cdeg
        return servo.user_cdeg(low_cdeg - 1 if servo.wire_cdeg(from_cdeg) < low_cdeg else high_cdeg)

    def landing_cdeg(self) -> dict[int, int]:
        """Return the landing pose by servo: the calibration's angles before the settings'; only allowed angles."""
        pose = {**self.pose_of_settings, **self.calibration.landing_cdeg}
        return {servo_id: angle for servo_id, angle in pose.items() if self.why_not(servo_id, angle) is None}
