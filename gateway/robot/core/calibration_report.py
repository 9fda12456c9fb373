"""A calibration as `hexapod/calibration` tells it, and back. Degrees there, hundredths of a degree here."""

from gateway.robot.core.calibration import Calibration, CalibrationError, ServoCalibration
from gateway.robot.protocol.frames import centidegrees
from schemas import calibration as wire
from schemas.robot import SERVO_IDS


def report_of(calibration: Calibration) -> wire.Calibration:
    """What is told: all servos by name, so that it can be sent back whole."""
    servos = {
        str(servo_id): wire.ServoCalibration(
            trim_deg=servo.trim_cdeg / 100,
            inverted=servo.inverted,
            min_deg=servo.min_cdeg / 100,
            max_deg=servo.max_cdeg / 100,
        )
        for servo_id in SERVO_IDS
        for servo in (calibration.of(servo_id),)
    }
    landing = {str(servo_id): angle_cdeg / 100 for servo_id, angle_cdeg in sorted(calibration.landing_cdeg.items())}
    return wire.Calibration(revision=calibration.revision, servos=servos, landing=landing)


def calibration_of(report: wire.Calibration) -> Calibration:
    """What was told. Raises CalibrationError, or another ValueError, for what no gateway says."""
    try:
        servos = {
            int(name): ServoCalibration(
                centidegrees(servo.trim_deg), servo.inverted, centidegrees(servo.min_deg), centidegrees(servo.max_deg)
            )
            for name, servo in report.servos.items()
        }
        landing_cdeg = {int(name): centidegrees(angle_deg) for name, angle_deg in report.landing.items()}
    except OverflowError as error:
        raise CalibrationError("an angle is infinite") from error
    return Calibration(report.revision, servos, landing_cdeg)
