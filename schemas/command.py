"""Payloads of the command keys, strict and closed: no unknown fields, no strings for numbers."""

from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter
from pydantic.fields import FieldInfo

from schemas.keys import MAX_SOURCE

MAX_PAYLOAD_BYTES: Final = 4096
"""A LegsCommand with all optional fields at full length has some 1200 bytes; a longer payload is rejected unread."""

MAX_SENT_MS: Final = 2**53
"""285 000 years. Above it a double cannot hold whole milliseconds; a larger value has other units."""

MAX_NUMBER: Final = 2**53
"""Larger whole numbers are not exact in every JSON reader."""

AngleDeg = Annotated[float, Field(ge=0.0, le=180.0, allow_inf_nan=False, description="to the nearest hundredth")]
Source = Annotated[
    str, Field(min_length=1, max_length=MAX_SOURCE, description="the sender's name; default: its Zenoh id")
]
SentMs = Annotated[
    float,
    Field(
        ge=0.0,
        le=MAX_SENT_MS,
        allow_inf_nan=False,
        description="the publisher's own monotonic clock",
    ),
]


def hex_digits(what: str) -> FieldInfo:
    """Return the field of 128 random bits from the gateway; `what` is its description."""
    field: FieldInfo = Field(min_length=32, max_length=32, pattern="^[0-9a-f]{32}$", description=what)
    return field


LeaseToken = Annotated[str, hex_digits("token of the lease, a secret")]
"""A secret: in no report, log line or repr."""

EstopNumber = Annotated[int, Field(ge=0, le=MAX_NUMBER, description="number of the latest emergency stop")]


class Closed(BaseModel):
    """Strict and frozen; rejects unknown fields."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", hide_input_in_errors=True)


class Sender(Closed):
    """The optional top-level fields of a command: its sender, the time by the sender's clock, and the lease's token."""

    source: Source | None = None
    sent_ms: SentMs | None = None
    lease: Annotated[LeaseToken | None, Field(repr=False)] = None


class AnySender(BaseModel):
    """The sender of a payload with any other fields."""

    model_config = ConfigDict(strict=True, frozen=True, extra="ignore")
    source: Source | None = None


class Move(Closed):
    """Energise a servo and set its angle (`start`), or set the angle of one that runs (`set`)."""

    op: Annotated[Literal["start", "set"], Field(description="energise and set, set, or de-energise")]
    angle_deg: AngleDeg


class Stop(Closed):
    """De-energise a servo."""

    op: Literal["stop"]


ServoSetpoint = Annotated[Move | Stop, Field(discriminator="op")]


class LegSetpoint(Closed):
    """The setpoints of one leg's three servos: joints 1, 2, 3, from the body outward."""

    servos: Annotated[tuple[ServoSetpoint, ServoSetpoint, ServoSetpoint], Field(description="joints 1, 2, 3")]


class LegCommand(LegSetpoint, Sender):
    """The payload of `hexapod/leg/{1..6}/cmd`."""


class LegsCommand(Sender):
    """The payload of `hexapod/legs/cmd`: one to six legs, accepted or rejected as a whole."""

    legs: Annotated[
        dict[Literal["1", "2", "3", "4", "5", "6"], LegSetpoint], Field(min_length=1, description="one to six legs")
    ]


class MoveCommand(Move, Sender):
    """The payload of `hexapod/servo/{11..63}/cmd` that starts or sets."""


class StopCommand(Stop, Sender):
    """The payload of `hexapod/servo/{11..63}/cmd` that stops."""


ServoCommand = Annotated[MoveCommand | StopCommand, Field(discriminator="op")]
SERVO_COMMAND: Final[TypeAdapter[MoveCommand | StopCommand]] = TypeAdapter(
    ServoCommand, config=ConfigDict(hide_input_in_errors=True)
)


class ResetCommand(Sender):
    """The payload of `hexapod/reset/cmd`. Without `estop` it is rejected until 2 s after the latest emergency stop."""

    estop: EstopNumber | None = None
