"""Events, and records of frames."""

from typing import Annotated

from pydantic import AwareDatetime, Field

from schemas.report import Count, Report
from schemas.words import AnyCause, AnyKind, AnyReason


class Event(Report):
    """The payload of `hexapod/event`."""

    time: Annotated[AwareDatetime, Field(description="when")]
    kind: Annotated[AnyKind, Field(description="what happened")]
    source: Annotated[str | None, Field(description="the name of who caused it")]
    source_id: Annotated[str | None, Field(description="the Zenoh id of who caused it, if the message had it")] = None
    key: Annotated[str | None, Field(description="of the command")]
    reason: Annotated[AnyReason | None, Field(description="of a rejection or an overflow")]
    detail: Annotated[str, Field(description="one sentence")]
    left_out: Annotated[Count, Field(description="such events left out before this one (Behaviour *Events*)")] = 0
    legs: Annotated[tuple[int, ...], Field(description="legs that stop, land, change their source or are named")] = ()
    incident: Annotated[str | None, Field(description="id of its incident in the black box")] = None
    cause: Annotated[AnyCause | None, Field(description="of `legs_stopped`")] = None


class FrameRecord(Report):
    """The payload of `hexapod/frame`: one frame written to SPI."""

    time: Annotated[AwareDatetime, Field(description="when")]
    monotonic_ns: Annotated[int, Field(description="when, by the gateway's monotonic clock")]
    bytes: Annotated[str, Field(description="in hex, without framing")]
    cause: Annotated[AnyCause, Field(description="why it was written")]
