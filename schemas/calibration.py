"""How this robot differs from the drawing: trim, direction and limits of each servo, and the landing pose.

Both directions use the same names: the payload of `hexapod/calibration` can be sent to `hexapod/calibration/cmd`,
whole or in part.
"""

from typing import Annotated, Final, Literal, get_args

from pydantic import Field

from schemas.command import AngleDeg, Closed, Sender
from schemas.robot import SERVO_IDS
from schemas.telemetry import Count, Report

MAX_TRIM_DEG: Final = 90.0
"""A horn further off is mounted a quarter of a turn wrong, and should be moved by hand."""

TrimDeg = Annotated[
    float,
    Field(
        ge=-MAX_TRIM_DEG,
        le=MAX_TRIM_DEG,
        allow_inf_nan=False,
        description="degrees added to the angle on the wire, to the nearest hundredth",
    ),
]

# fmt: off
ServoName = Literal[
    "11", "12", "13", "21", "22", "23", "31", "32", "33", "41", "42", "43", "51", "52", "53", "61", "62", "63"
]
# fmt: on
if get_args(ServoName) != tuple(map(str, SERVO_IDS)):  # a type cannot be computed
    raise AssertionError("ServoName names other servos than schemas.robot")


class ServoCalibration(Report):
    """One servo: `wire = (180 - angle if inverted else angle) + trim_deg`; the limits are users' angles."""

    trim_deg: float = 0.0
    inverted: bool = False
    min_deg: float = 0.0
    max_deg: float = 180.0


class Calibration(Report):
    """The payload of `hexapod/calibration`: what is in force. An unnamed servo has no trim and the full range."""

    revision: Count
    servos: dict[str, ServoCalibration]
    landing: Annotated[dict[str, float], Field(description="the landing pose: degrees, as users count them")]


class ServoChange(Closed):
    """Changes of one servo; an unnamed value stays."""

    trim_deg: TrimDeg | None = None
    inverted: bool | None = None
    min_deg: AngleDeg | None = None
    max_deg: AngleDeg | None = None


class CalibrationCommand(Sender):
    """The payload of `hexapod/calibration/cmd`: a whole Calibration, or the part of it that changes.

    `revision`: of the calibration that it changes; another one in force means that it was changed meanwhile. Without
    it, nothing is compared. A landing angle of null removes the servo from the landing pose. `accept_default` accepts
    the calibration without any trim as this robot's, if its own file cannot be read.
    """

    revision: Count | None = None
    servos: Annotated[dict[ServoName, ServoChange], Field(default_factory=dict)]
    landing: Annotated[dict[ServoName, AngleDeg | None], Field(default_factory=dict)]
    accept_default: Literal[True] | None = None
