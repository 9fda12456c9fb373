"""Answers to requests."""

from typing import Annotated, Literal, Self

from pydantic import Field

from schemas.report import Count, Sparse
from schemas.words import AnyReason


class Answer(Sparse):
    """What every reply to a request contains."""

    accepted: Annotated[bool, Field(description="whether the request took effect")]
    reason: Annotated[AnyReason | None, Field(description="why it was rejected")] = None
    detail: Annotated[str | None, Field(description="one sentence")] = None

    def or_raise(self) -> Self:
        """Return itself. Raises RejectedError with the gateway's reason if the request was rejected."""
        if not self.accepted:
            from gateway.errors import RejectedError  # noqa: PLC0415  # schemas alone need no gateway

            raise RejectedError(str(self.reason or ""), self.detail or "no reason was given")
        return self


class Ack(Answer):
    """The reply to an acknowledged command; null fields are left out of the JSON."""

    coalesced: Annotated[Literal[True] | None, Field(description="a newer command replaced it before its frame")] = None
    written: Annotated[
        list[int] | None,
        Field(description="if not accepted: legs already written (*Answered in part*)"),
    ] = None
    stopped: Annotated[
        Literal[True] | None,
        Field(description="if not accepted: its servos are stopped anyway"),
    ] = None
    stop_frames: Annotated[Count | None, Field(description="of an emergency stop: Stop frames written")] = None
    estop: Annotated[Count | None, Field(description="of an emergency stop: its number")] = None
    kept: Annotated[
        bool | None,
        Field(description="of an emergency stop: whether it was on the disk when this left; null: no state folder"),
    ] = None
    latency_us: Annotated[
        float | None, Field(ge=0, description="of an emergency stop: request to last Stop written")
    ] = None
    confirmed: Annotated[bool | None, Field(description="of a Stop: whether the power board confirmed it")] = None
    confirmed_ms: Annotated[float | None, Field(ge=0, description="from the command to that confirmation")] = None

    def __bool__(self) -> bool:
        """Whether the command was accepted."""
        return self.accepted
