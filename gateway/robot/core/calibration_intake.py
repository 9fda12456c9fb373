"""Reads a CalibrationCommand. Pure."""

from typing import Final

from pydantic import ValidationError

from gateway.robot.core.rejections import TOO_MANY_FIELDS, Rejection, explain, name_given_twice
from schemas.calibration import CalibrationCommand
from schemas.robot import SERVO_IDS

_MAX_COLONS: Final = 7 + len(SERVO_IDS) * (1 + 4 + 1) + 64
"""A CalibrationCommand with all fields: for each servo its name, four numbers and a landing angle, and a source of
colons. A payload with more is rejected before pydantic lists each wrong field."""


def read(payload: bytes) -> CalibrationCommand | Rejection:
    """Return the command in a payload (JSON), or a Rejection with the reason. Never raises."""
    if payload.count(b":") > _MAX_COLONS:
        return TOO_MANY_FIELDS
    try:
        command = CalibrationCommand.model_validate_json(payload)
    except ValidationError as error:
        return explain(error)
    return name_given_twice(payload) or command
