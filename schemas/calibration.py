"""How this robot differs from the drawing: trim, direction and limits of each servo, and the landing pose.

Both directions use the same names: the payload of `hexapod/calibration` can be sent to `hexapod/calibration/cmd`,
whole or in part.
"""

from typing import Annotated, Final, Literal, get_args

from pydantic import Field

from schemas.command import AngleDeg, Closed, Sender
from schemas.report import Count, Report
from schemas.robot import SERVO_IDS

MAX_TRIM_DEG: Final = 90.0
"""A horn that is further off is mounted a quarter of a turn wrong; move it by hand."""

TrimDeg = Annotated[
    float,
    Field(
        ge=-MAX_TRIM_DEG,
        le=MAX_TRIM_DEG,
        allow_inf_nan=False,
        description="added to the angle on the wire",
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
    """One servo: `wire = (180 - angle if inverted else angle) + trim_deg`. The limits are angles of commands."""

    trim_deg: Annotated[float, Field(description="added to the angle on the wire")] = 0.0
    inverted: Annotated[bool, Field(description="180 - angle on the wire")] = False
    min_deg: Annotated[float, Field(description="lowest angle in commands")] = 0.0
    max_deg: Annotated[float, Field(description="highest angle in commands")] = 180.0


class Calibration(Report):
    """The payload of `hexapod/calibration`, in force now. An unnamed servo has no trim and the full range."""

    revision: Annotated[Count, Field(description="counts the changes; 0: the default")]
    servos: Annotated[dict[str, ServoCalibration], Field(description="by id")]
    landing: Annotated[dict[str, float], Field(description="landing pose; else that of the settings")]


class ServoChange(Closed):
    """Changes of one servo; an unnamed value stays."""

    trim_deg: TrimDeg | None = None
    inverted: Annotated[bool | None, Field(description="180 - angle on the wire")] = None
    min_deg: Annotated[AngleDeg | None, Field(description="lowest angle in commands")] = None
    max_deg: Annotated[AngleDeg | None, Field(description="highest angle in commands")] = None


class CalibrationCommand(Sender):
    """The payload of `hexapod/calibration/cmd`: a whole Calibration, or the part of it that changes.

    `revision`: of the calibration that it changes; if another is in force, the command is rejected. Without it, nothing
    is compared. A landing angle of null removes the servo from the landing pose. `accept_default` accepts a calibration
    without any trim if the robot's own file cannot be read.
    """

    revision: Annotated[Count | None, Field(description="of the calibration that it changes; another: `stale`")] = None
    servos: Annotated[dict[ServoName, ServoChange], Field(default_factory=dict, description="by id")]
    landing: Annotated[
        dict[ServoName, AngleDeg | None], Field(default_factory=dict, description="landing pose, or null")
    ]
    accept_default: Annotated[Literal[True] | None, Field(description="replace a broken file with no trim")] = None
