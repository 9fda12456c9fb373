"""The supervisor's vocabulary: what happens to it (events), and what it wants done (effects)."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar, dataclass_transform

from gateway.robot.core.calibration import Calibration, Change
from gateway.robot.protocol.frames import Frame, ServoOp
from schemas.telemetry import Cause, Kind, Reason

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def value(cls: type[T]) -> type[T]:
    """A dataclass that is frozen for the type checker only: one that is frozen at run time takes four times as long."""
    return dataclass(slots=True, unsafe_hash=True)(cls)


# ---- events


@value
class BusOpened:
    """The device has been opened and its preamble written."""


@value
class BusFailed:
    """A transfer failed, or the device could not be opened again."""

    detail: str


@value
class Command:
    """A valid command: what each of these servos should do. `number` is its own; `channel` is the way it came.

    Commands of one channel are in order among themselves; of two channels in one instant nobody knows which is older.
    """

    number: int
    channel: str
    targets: tuple[tuple[int, ServoOp], ...]
    source: str | None = None
    """For people: it decides nothing that is sent."""
    lease: str | None = field(default=None, repr=False)
    """The token that it carries."""
    lost: bool = False
    """Nobody's command: Stops that stand for messages of the channel which were lost."""


@value
class EmergencyStop:
    """Somebody wants everything stopped."""

    source: str | None = None
    key: str | None = None


@value
class Reset:
    """Somebody wants to leave the emergency stop with number `estop`; None: they did not say which one."""

    number: int
    source: str | None = None
    key: str | None = None
    estop: int | None = None
    lease: str | None = field(default=None, repr=False)


class Do(StrEnum):
    """What somebody wants of the lease."""

    ACQUIRE = "acquire"
    ASK = "ask"
    TAKE = "take"
    RENEW = "renew"
    RELEASE = "release"


@value
class LeaseRequest:
    """Somebody wants something of the lease; where names have to be proved, `source` is.

    `fresh_token` is 128 random bits, for a lease that it may give.
    """

    do: Do
    source: str | None = None
    verified: bool = False
    token: str | None = field(default=None, repr=False)
    to: str | None = None
    fresh_token: str = field(default="", repr=False)


class ButtonDo(StrEnum):
    """What a button wants."""

    REGISTER = "register"
    ALIVE = "alive"
    LEAVE = "leave"


@value
class ButtonRequest:
    """A button registers (where names have to be proved, `source` is), checks in, or leaves.

    `received_ns` is when that came; `fresh_token` is 128 random bits, for a registration. `holder` is the certificate
    that has proved `source` (None: nothing is proved), and `counts` whether that one may be required.
    """

    do: ButtonDo
    received_ns: int
    source: str | None = None
    holder: str | None = None
    counts: bool = True
    token: str = field(default="", repr=False)
    count: int = 0
    sent_ms: float | None = None
    fresh_token: str = field(default="", repr=False)


@value
class Calibrate:
    """Somebody wants the calibration changed: the one with this `revision`, or whichever is in force (None).

    `accept_default` takes the default calibration (with `change`, if that says anything) as this robot's, where the
    file that kept its own cannot be read.
    """

    number: int
    change: Change
    revision: int | None = None
    accept_default: bool = False
    source: str | None = None
    key: str | None = None
    lease: str | None = field(default=None, repr=False)


@value
class Kept:
    """The calibration of the Keep with this number is on the disk; with a `fault`, the old one still is."""

    number: int
    fault: str | None = None


@value
class StoppedOutside:
    """`stop-servos` is stopping all servos past us; or has ended (not `at_work`), and none of its Stops is to come."""

    at_work: bool


@value
class TimePassed:
    """Nothing but time; send it when `due_ns` has come."""


@value
class ShutDown:
    """The service ends."""


Event = (
    BusOpened
    | BusFailed
    | Command
    | EmergencyStop
    | Reset
    | LeaseRequest
    | ButtonRequest
    | Calibrate
    | Kept
    | StoppedOutside
    | TimePassed
    | ShutDown
)

# ---- effects, to be carried out in their order


@value
class Transmit:
    """Write this frame now. `deadline_ns` is when a watchdog's Stop was due."""

    frame: Frame
    cause: Cause
    deadline_ns: int | None = None
    numbers: tuple[int, ...] = ()
    """The commands that it carries out, or a part of them."""
    joins: bool = False
    """A repeated Stop that leaves in one call with the step's first Stops, behind them, and needs no preamble."""


@value
class Completed:
    """The command is done: its frames are written, or a newer command replaced what waited of it (`coalesced`)."""

    number: int
    coalesced: bool = False


@value
class Rejected:
    """The command takes no effect (any more)."""

    number: int
    reason: Reason
    detail: str


@value
class Announce:
    """Something happened that people want to know. `legs`, ascending, are those that it is about."""

    kind: Kind
    detail: str
    source: str | None = None
    key: str | None = None
    legs: tuple[int, ...] = ()
    reason: Reason | None = None


@value
class Answer:
    """To a LeaseRequest or a ButtonRequest: granted, if there is no `reason`.

    `token` is that of the lease, or of the registration, which it gives; `detail` also what a button that is granted
    should know.
    """

    reason: Reason | None = None
    detail: str = ""
    token: str | None = field(default=None, repr=False)


@value
class Keep:
    """Write this calibration to the disk, without making anything wait for it, and answer with Kept in any case.

    Until then the old calibration is in force, and command `number` has no answer.
    """

    number: int
    calibration: Calibration


Effect = Transmit | Completed | Rejected | Announce | Answer | Keep
Decision = tuple[list[Effect], Answer]
"""What comes of a request: what is told of it, and its answer."""
