"""Reads a CalibrationCommand, and converts it to a change of the calibration. Pure."""

from typing import Final

from pydantic import TypeAdapter

from gateway.model.calibration import CalibrationChange, MappingChange
from gateway.model.frames import centidegrees
from gateway.robot.core.intake import parse
from gateway.robot.core.rejections import Rejection
from schemas.calibration import CalibrationCommand
from schemas.robot import SERVO_IDS

_SCHEMA: Final = TypeAdapter(CalibrationCommand)
_MOST_FIELDS: Final = 7 + len(SERVO_IDS) * (1 + 4 + 1)
"""For each servo its name, four numbers and a landing angle."""


def read(payload: bytes) -> CalibrationCommand | Rejection:
    """Return the command in a payload (JSON), or a Rejection with the reason. Never raises."""
    return parse(payload, _MOST_FIELDS, _SCHEMA)


def change_of(command: CalibrationCommand) -> CalibrationChange:
    """Return the change in hundredths of a degree, not yet compared with the calibration in force."""
    servos = {
        int(name): MappingChange(_cdeg(servo.trim_deg), servo.inverted, _cdeg(servo.min_deg), _cdeg(servo.max_deg))
        for name, servo in command.servos.items()
    }
    return CalibrationChange(servos, {int(name): _cdeg(angle_deg) for name, angle_deg in command.landing.items()})


def _cdeg(angle_deg: float | None) -> int | None:
    return None if angle_deg is None else centidegrees(angle_deg)
