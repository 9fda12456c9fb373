"""The calibration: trim, direction and limits of each servo, between users' and wire angles. Pure.

    wire = (180 - user if inverted else user) + trim

in hundredths of a degree, so that conversions lose nothing. Commands, limits, state and events have users' angles; only
frames have the servos' own. All conversions between the two, and to the degrees of `schemas.calibration`, are here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from gateway.model.frames import MAX_ANGLE_CDEG, OP_START, OP_STOP, SETS, STARTS, Frame, centidegrees, frame_of
from schemas import calibration as wire
from schemas.robot import SERVO_IDS

MAX_TRIM_CDEG: Final = 90_00


class CalibrationError(ValueError):
    """The calibration is invalid; the message names the servo and the fault."""


class ServoMapping(NamedTuple):
    """How one servo's angle on the wire follows from the user's, in hundredths of a degree.

    The limits are users' angles, both ends included.
    """

    trim_cdeg: int = 0
    inverted: bool = False
    min_cdeg: int = 0
    max_cdeg: int = MAX_ANGLE_CDEG

    def wire_cdeg(self, user_cdeg: int) -> int:
        """Return the servo's own angle, which may lie outside 0 to 18000."""
        return (MAX_ANGLE_CDEG - user_cdeg if self.inverted else user_cdeg) + self.trim_cdeg

    def user_cdeg(self, wire_cdeg: int) -> int:
        """Return the user's angle."""
        untrimmed = wire_cdeg - self.trim_cdeg
        return MAX_ANGLE_CDEG - untrimmed if self.inverted else untrimmed

    @property
    def report(self) -> wire.ServoCalibration:
        """The published form, in degrees."""
        trim_deg, min_deg, max_deg = (cdeg / 100 for cdeg in (self.trim_cdeg, self.min_cdeg, self.max_cdeg))
        return wire.ServoCalibration(trim_deg=trim_deg, inverted=self.inverted, min_deg=min_deg, max_deg=max_deg)


AS_DRAWN: Final = ServoMapping()


@dataclass(frozen=True, slots=True)
class RobotCalibration:
    """All servos, and the landing pose in users' angles. `revision` counts the changes; 0 is the default's.

    Raises CalibrationError for a trim beyond 90 degrees, limits the wrong way round, and a landing pose out of reach.
    Servos that are as drawn are left out of `servos`, so the default has none and costs nothing.
    """

    revision: int = 0
    servos: Mapping[int, ServoMapping] = field(default_factory=dict)
    landing_cdeg: Mapping[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for servo_id, servo in self.servos.items():
            if abs(servo.trim_cdeg) > MAX_TRIM_CDEG:
                raise CalibrationError(f"servo {servo_id}: trim_deg is {servo.trim_cdeg / 100:g}; it is -90 to 90")
            if not 0 <= servo.min_cdeg <= servo.max_cdeg <= MAX_ANGLE_CDEG:
                low, high = servo.min_cdeg / 100, servo.max_cdeg / 100
                limits = f"min_deg is {low:g} and max_deg {high:g}"
                raise CalibrationError(f"servo {servo_id}: {limits}; they are 0 to 180, min_deg must not be larger")
        for servo_id, angle_cdeg in self.landing_cdeg.items():
            why_not = self.why_not(servo_id, angle_cdeg)
            if why_not is not None:
                raise CalibrationError(f"the landing pose cannot be reached: {why_not}")
        object.__setattr__(self, "servos", {name: servo for name, servo in self.servos.items() if servo != AS_DRAWN})

    def of(self, servo_id: int) -> ServoMapping:
        """Return one servo's mapping."""
        return self.servos.get(servo_id, AS_DRAWN)

    def why_not(self, servo_id: int, user_cdeg: int) -> str | None:
        """Return why the servo must not go to this user's angle, or None if it may."""
        servo = self.servos.get(servo_id)
        if servo is None:
            return None
        if not servo.min_cdeg <= user_cdeg <= servo.max_cdeg:
            low, high, angle = (cdeg / 100 for cdeg in (servo.min_cdeg, servo.max_cdeg, user_cdeg))
            return f"servo {servo_id} is calibrated to go from {low:g} to {high:g} degrees; {angle:g} is outside"
        wire_cdeg = servo.wire_cdeg(user_cdeg)
        if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:
            angle, own = user_cdeg / 100, wire_cdeg / 100
            return f"{angle:g} degrees of servo {servo_id} are its own {own:g}, with its trim; a servo has 0 to 180"
        return None

    def frame(self, frame: Frame) -> Frame:
        """Return the wire's frame for one in users' angles, which `why_not` allows."""
        return _mapped(frame, lambda servo_id, cdeg: self.of(servo_id).wire_cdeg(cdeg)) if self.servos else frame

    def user_frame(self, frame: Frame) -> Frame:
        """Return the wire's frame in users' angles. Raises FrameError if an angle is outside 0 to 18000."""
        return _mapped(frame, lambda servo_id, cdeg: self.of(servo_id).user_cdeg(cdeg))


def _mapped(frame: Frame, cdeg_of: Callable[[int, int], int]) -> Frame:
    return frame_of(
        tuple(
            (each, op if op.op is OP_STOP else (STARTS if op.op is OP_START else SETS)[cdeg_of(each, op.angle_cdeg)])
            for each, op in frame.servos
        )
    )


def changed_servos(before: RobotCalibration, after: RobotCalibration) -> list[int]:
    """Return the servos whose frames or limits differ, ascending; the landing pose alone changes none."""
    return [servo_id for servo_id in SERVO_IDS if before.of(servo_id) != after.of(servo_id)]


def report_of(calibration: RobotCalibration) -> wire.Calibration:
    """Return the published form: all servos by name, so that it can be sent back whole."""
    return wire.Calibration(
        revision=calibration.revision,
        servos={str(servo_id): calibration.of(servo_id).report for servo_id in SERVO_IDS},
        landing={str(servo_id): angle / 100 for servo_id, angle in sorted(calibration.landing_cdeg.items())},
    )


def calibration_of(report: wire.Calibration) -> RobotCalibration:
    """Return the calibration of a published form. Raises ValueError if it is invalid."""
    whole = wire.CalibrationCommand.model_validate(report.model_dump())
    return replace(changed(RobotCalibration(), whole), revision=report.revision)


def changed(before: RobotCalibration, change: wire.CalibrationCommand) -> RobotCalibration:
    """Return the changed calibration, with the next revision. Raises CalibrationError if it is invalid."""
    servos, landing_cdeg = dict(before.servos), dict(before.landing_cdeg)
    for name, each in change.servos.items():
        servo = before.of(int(name)).report.model_copy(update=each.model_dump(exclude_none=True))
        trim_cdeg, min_cdeg, max_cdeg = map(centidegrees, (servo.trim_deg, servo.min_deg, servo.max_deg))
        servos[int(name)] = ServoMapping(trim_cdeg, servo.inverted, min_cdeg, max_cdeg)
    for name, angle_deg in change.landing.items():
        landing_cdeg.pop(int(name), None)
        if angle_deg is not None:
            landing_cdeg[int(name)] = centidegrees(angle_deg)
    return RobotCalibration(before.revision + 1, servos, landing_cdeg)
