"""The records of a black box as its readers get them. `gateway.model.black_box.format` has their bytes."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from gateway.model import elkapod
from gateway.model.frames import ServoOp
from schemas.calibration import Calibration


class Start(NamedTuple):
    """A gateway starts. `wall_ns`: wall-clock time at this moment."""

    wall_ns: int
    facts: dict[str, Any]


class End(NamedTuple):
    """A gateway ends, after its last Stops."""

    why: str


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


class ModeChange(NamedTuple):
    """The gateway's mode from now on."""

    mode: str


class EventPublished(NamedTuple):
    """A published event."""

    kind: str
    source: str | None
    key: str | None
    reason: str | None
    detail: str
    left_out: int


class Lag(NamedTuple):
    """The loop's timer ran late."""

    lag_ns: int


class Clock(NamedTuple):
    """Wall-clock time at this moment, recorded once a second."""

    wall_ns: int


class IncidentBegun(NamedTuple):
    """An incident begins. `wall_ns`: wall-clock time at this moment."""

    wall_ns: int
    incident: str


class Calibrated(NamedTuple):
    """The calibration in force from now on. Before a change, the previous one is recorded, too."""

    calibration: Calibration


class About(NamedTuple):
    """Version and settings, recorded every ten seconds, so that each incident's file has them."""

    facts: dict[str, Any]


class BodyState(NamedTuple):
    """The robot's measurements, recorded ten times a second at most."""

    values: elkapod.Measured


@dataclass(frozen=True, slots=True)
class LeftOut:
    """`count` records of a source were left out since the last such record, beyond the source's share."""

    count: int
    source: str | None


Content = (
    Start
    | End
    | CommandRecord
    | Decision
    | FrameWritten
    | ModeChange
    | EventPublished
    | Lag
    | Clock
    | IncidentBegun
    | Calibrated
    | About
    | BodyState
    | LeftOut
)


class Record(NamedTuple):
    """One record; `ns` is of the monotonic clock."""

    sequence: int
    ns: int
    content: Content
