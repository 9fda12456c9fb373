"""The supervisor's vocabulary: what happens to it (events), and what it wants done (effects)."""

from dataclasses import dataclass

from gateway.protocol.frames import Frame, ServoOp
from schemas.telemetry import Cause, Kind, Reason

# ---- events


@dataclass(frozen=True, slots=True)
class BusOpened:
    """The device has been opened and its preamble written."""


@dataclass(frozen=True, slots=True)
class BusFailed:
    """A transfer failed, or the device could not be opened again."""

    detail: str


@dataclass(frozen=True, slots=True)
class Command:
    """A valid command: what each of these servos should do. `number` is its own; `channel` is the way it came.

    Commands of one channel are in order among themselves; of two channels in one instant nobody knows which is older.
    """

    number: int
    channel: str
    targets: tuple[tuple[int, ServoOp], ...]
    source: str | None = None
    """For people: it decides nothing that is sent."""


@dataclass(frozen=True, slots=True)
class EmergencyStop:
    """Somebody wants everything stopped."""

    source: str | None = None
    key: str | None = None


@dataclass(frozen=True, slots=True)
class Reset:
    """Somebody wants to leave the emergency stop with number `estop`; None: they did not say which one."""

    number: int
    source: str | None = None
    key: str | None = None
    estop: int | None = None


@dataclass(frozen=True, slots=True)
class StoppedOutside:
    """`stop-servos` is stopping all servos past us; or has ended (not `at_work`), and none of its Stops is to come."""

    at_work: bool


@dataclass(frozen=True, slots=True)
class TimePassed:
    """Nothing but time; send it when `due_ns` has come."""


@dataclass(frozen=True, slots=True)
class ShutDown:
    """The service ends."""


Event = BusOpened | BusFailed | Command | EmergencyStop | Reset | StoppedOutside | TimePassed | ShutDown

# ---- effects, to be carried out in their order


@dataclass(frozen=True, slots=True)
class Transmit:
    """Write this frame now. `deadline_ns` is when a watchdog's Stop was due."""

    frame: Frame
    cause: Cause
    deadline_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Completed:
    """The command is done: its frames are written, or a newer command replaced what waited of it (`coalesced`)."""

    number: int
    coalesced: bool = False


@dataclass(frozen=True, slots=True)
class Rejected:
    """The command takes no effect (any more)."""

    number: int
    reason: Reason
    detail: str


@dataclass(frozen=True, slots=True)
class Announce:
    """Something happened that people want to know."""

    kind: Kind
    detail: str
    source: str | None = None
    key: str | None = None


Effect = Transmit | Completed | Rejected | Announce
