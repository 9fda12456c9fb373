"""The records of a black box as its readers get them. `gateway.model.black_box.format` has their bytes."""

from typing import Any, NamedTuple

from gateway.model.elkapod import Measured
from gateway.model.frames import ServoOp
from schemas.calibration import Calibration


class Start(NamedTuple):
    """A gateway starts. `wall_ns`: wall-clock time at this moment."""

    wall_ns: int
    facts: dict[str, Any]


class CommandRecord(NamedTuple):
    """A decoded command; the record's time is its arrival. A Decision with its number follows (0: none does)."""

    number: int
    verb: str
    key: str
    source: str | None
    sent_ms: float | None
    targets: tuple[tuple[int, ServoOp], ...]


class Decision(NamedTuple):
    """The outcome of a command: "accepted", "coalesced", or the reason of its rejection."""

    number: int
    verdict: str
    key: str
    source: str | None


class FrameWritten(NamedTuple):
    """A written frame; the record's time is the end of its transfer. `late_ns`: a watchdog's Stop after its deadline.

    `number`: the command accepted with it, which then has no Decision; 0: none.
    """

    data: bytes
    cause: str
    transfer_ns: int
    late_ns: int = 0
    number: int = 0


class EventPublished(NamedTuple):
    """A published event."""

    kind: str
    source: str | None
    key: str | None
    reason: str | None
    detail: str
    left_out: int


class Noted(NamedTuple):
    """What happened to the gateway itself; `what` is end, mode, lag or left_out, as in a Note."""

    what: str
    detail: str
    source: str | None = None


class WallTime(NamedTuple):
    """Wall-clock time at this moment: once a second, and at the beginning of an incident."""

    wall_ns: int
    incident: str = ""
    """Its id, or ""."""


class About(NamedTuple):
    """Version and settings, recorded every ten seconds, so that each incident's file has them."""

    facts: dict[str, Any]


Content = (
    Start | CommandRecord | Decision | FrameWritten | EventPublished | Noted | WallTime | About | Calibration | Measured
)
"""A Calibration is in force from then on; before a change, the previous one is recorded, too."""


class Record(NamedTuple):
    """One record; `ns` is of the monotonic clock."""

    sequence: int
    ns: int
    content: Content
