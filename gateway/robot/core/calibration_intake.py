"""Reads a CalibrationCommand, and converts it to a change of the calibration. Pure."""

from typing import Final

from pydantic import ValidationError

from gateway.model.calibration import CalibrationChange, MappingChange
from gateway.model.frames import centidegrees
from gateway.robot.core.rejections import Rejection, explain, given_twice, name_given_twice, too_many_fields
from schemas.calibration import CalibrationCommand
from schemas.robot import SERVO_IDS

_MAX_COLONS: Final = 7 + len(SERVO_IDS) * (1 + 4 + 1) + 64
"""A CalibrationCommand with all fields: for each servo its name, four numbers and a landing angle, and a source of
colons. A payload with more is rejected before pydantic lists each wrong field."""


def read(payload: bytes) -> CalibrationCommand | Rejection:
    """Return the command in a payload (JSON), or a Rejection with the reason. Never raises."""
    if payload.count(b":") > _MAX_COLONS:
        return too_many_fields(payload)
    try:
        command = CalibrationCommand.model_validate_json(payload)
    except ValidationError as error:
        return explain(error)
    twice = name_given_twice(payload)
    return command if twice is None else given_twice(twice)


def change_of(command: CalibrationCommand) -> CalibrationChange:
    """Return the change in hundredths of a degree, not yet compared with the calibration in force."""
    servos = {
        int(name): MappingChange(_cdeg(servo.trim_deg), servo.inverted, _cdeg(servo.min_deg), _cdeg(servo.max_deg))
        for name, servo in command.servos.items()
    }
    return CalibrationChange(servos, {int(name): _cdeg(angle_deg) for name, angle_deg in command.landing.items()})


def _cdeg(angle_deg: float | None) -> int | None:
    return None if angle_deg is None else centidegrees(angle_deg)
