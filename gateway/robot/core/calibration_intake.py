"""Reads a CalibrationCommand. Pure."""

from typing import Final

from pydantic import TypeAdapter

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
