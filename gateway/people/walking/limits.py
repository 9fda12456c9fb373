"""What a gateway allows each servo: its settings, its calibration, and what the wire can carry. Pure."""

from gateway.people.walking.robot import MAX_SPEED_DEG_S, Range
from schemas.calibration import Calibration
from schemas.robot import SERVO_IDS
from schemas.telemetry import LimitsReport, ServoLimitsReport

_FULL_DEG = 180.0


def ranges(limits: LimitsReport, calibration: Calibration | None) -> dict[int, Range]:
    """Of each servo, in degrees as commands name them; a speed that is not limited is that of a usual servo."""
    return {servo_id: _range(str(servo_id), limits, calibration) for servo_id in SERVO_IDS}


def _range(name: str, limits: LimitsReport, calibration: Calibration | None) -> Range:
    setting = limits.servos.get(name, ServoLimitsReport())
    found = Range(setting.min_deg, setting.max_deg, setting.max_speed_deg_s or MAX_SPEED_DEG_S)
    if calibration is None or (servo := calibration.servos.get(name)) is None:
        return found
    lowest_deg = servo.trim_deg if servo.inverted else -servo.trim_deg
    on_the_wire = Range(lowest_deg, lowest_deg + _FULL_DEG)
    return found.within(Range(servo.min_deg, servo.max_deg)).within(on_the_wire)
