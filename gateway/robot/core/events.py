"""What the supervisor receives (events), and what it wants done (effects)."""

from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import Final, Literal, final

from gateway.model.black_box.format import ACCEPTED, COALESCED
from gateway.model.calibration import CalibrationChange, RobotCalibration
from gateway.model.frames import OP_STOP, Frame, ServoOp
from gateway.robot.core.message import Reply, Verb
from gateway.robot.core.value import value
from schemas.telemetry import Cause, Kind, Reason

Targets = tuple[tuple[int, ServoOp], ...]
"""Operations for servos, by their ids."""

_GET: Final = Verb.GET  # see `frames.OP_STOP`

# ---- what is answered


@dataclass(slots=True, eq=False)
class Request:
    """A request: one object from its payload to its answer, which the owner of the state changes.

    The reader of its payload makes it, and adds how it came.
    """

    targets: Targets = ()
    """The operation for each servo."""
    _: KW_ONLY
    key: str = ""
    source: str | None = None
    """The sender's name, for people: it does not decide what is sent."""
    sent_ms: float | None = None
    lease: str | None = field(default=None, repr=False)
    """The token that it carries."""
    reply: Reply | None = field(default=None, repr=False)
    verb: Verb = Verb.PUT
    received_ns: int = 0
    number: int = 0
    """Its own, from 1 on, for the supervisor and the black box; 0: it is rejected before."""
    written: tuple[int, ...] = ()
    """The legs that a frame of it was written for; should it be rejected after that, its answer names them."""
    stopped: tuple[int, ...] = ()
    """The servos that it stops, or may stop, and that are stopped though it is rejected."""
    moves: Targets = field(init=False, default=())
    """Of a command: those of its targets that are no Stops."""

    @property
    def servo_ids(self) -> Iterable[int]:
        """The servos that the request names."""
        return (servo_id for servo_id, _ in self.targets)

    @property
    def only_stops(self) -> bool:
        """Whether the request stops servos and does nothing else. A reset stops none."""
        return bool(self.targets) and all(op.op is OP_STOP for _, op in self.targets)


@final
@dataclass(slots=True, eq=False, kw_only=True)
class Command(Request):
    """A valid command for servos, and how much of it is still to be written."""

    lost: bool = False
    """Whether these are Stops for lost messages of the channel, which no client sent."""
    rejected: "Rejected | None" = field(default=None, repr=False)
    """Why it was rejected before the supervisor takes it: only its Stops are carried out. For a message that could not
    be read, these are the Stops that it may contain, and another request is answered in its place."""
    by_leg: dict[int, Targets] = field(init=False)
    """The targets of each leg."""
    left: int = field(init=False)
    """How many of its targets are still to be written, or replaced by a newer command's."""
    coalesced: bool = False
    """Whether a newer command has replaced one of its targets."""

    def __post_init__(self) -> None:
        self.moves, self.by_leg, self.left = (), {}, 0
        for target in self.targets:
            servo_id, op = target
            leg = servo_id // 10
            self.by_leg[leg] = (*self.by_leg[leg], target) if leg in self.by_leg else (target,)
            self.left += 1
            if op.op is not OP_STOP:
                self.moves += (target,)

    @property
    def stops(self) -> Targets:
        """The targets that are Stops."""
        return tuple(target for target in self.targets if target[1].op is OP_STOP)

    @property
    def channel(self) -> str:
        """Verb and key. Commands of one channel came in their order; between channels the order is unknown."""
        return f"{'get' if self.verb is _GET else 'put'} {self.key}"


@final
@dataclass(slots=True, eq=False, kw_only=True)
class Reset(Request):
    """Leaves the emergency stop with number `estop`; None: the sender named none."""

    estop: int | None = None


@dataclass(slots=True, eq=False, kw_only=True)
class Calibrate(Request):
    """Changes the calibration with this `revision`; None: the one in force.

    `accept_default` takes the default calibration (with `change`, if that has anything) as this robot's, where the
    file with its own cannot be read.
    """

    change: CalibrationChange
    revision: int | None = None
    accept_default: bool = False

    @property
    def servo_ids(self) -> Iterable[int]:
        return (*self.change.servos, *self.change.landing_cdeg)


# ---- events


@value
class BusOpened:
    """The device has been opened and its preamble written."""


@value
class BusFailed:
    """A transfer failed, or the device could not be opened again.

    CONTROLLER_SILENT: the controller does not answer; CONTROLLER_RESTARTED: it may have forgotten all commands.
    """

    detail: str
    kind: Kind = Kind.BUS_FAULT
    """Which event reports it, if it is the first since the bus was opened."""


@value
class BodyMeasured:
    """The body's tilt in hundredths of a degree (None: unknown), and the battery's voltage in mV, as measured."""

    tilt_cdeg: int | None
    battery_mv: int


@value
class PowerSeen:
    """What the power board reports of the servos' supply."""

    alive: bool
    """Whether the board answers."""
    refused: tuple[tuple[int, str], ...] = ()
    """Servos that the board will not feed, and why."""
    fed: frozenset[int] = frozenset()
    """Servos that the board has confirmed to feed since their last start: their starts may leave."""
    lost: frozenset[int] = frozenset()
    """Servos that the board no longer feeds, though it should."""
    doubt: str = ""
    """Why a servo that should be off may still be on; "": all are known to be off."""


@value
class EmergencyStop:
    """Stops all six legs, and latches."""

    source: str | None = None
    key: str | None = None


class Do(StrEnum):
    """What a request about the lease asks for."""

    ACQUIRE = "acquire"
    ASK = "ask"
    TAKE = "take"
    RENEW = "renew"
    RELEASE = "release"


@value
class LeaseRequest:
    """A request about the lease; where names have to be proved, `source` is.

    `fresh_token` is 128 random bits, for a lease that it may give.
    """

    do: Do
    source: str | None = None
    verified: bool = False
    token: str | None = field(default=None, repr=False)
    to: str | None = None
    fresh_token: str = field(default="", repr=False)


class ButtonDo(StrEnum):
    """What a button's request asks for."""

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
class CalibrationSaved:
    """The calibration of the SaveCalibration with this number is on the disk; with a `fault`, the old one still is."""

    number: int
    fault: str | None = None


@value
class StoppedOutside:
    """`stop-servos` stops all servos past the gateway; not `at_work`: it has ended, and no Stop of it follows."""

    at_work: bool


@value
class EstopKept:
    """The emergency stop that an earlier run left. Comes once if `Rules.estop_kept`.

    `number` is that of the latest (0: none); `engaged`: no reset has left it.
    """

    number: int
    engaged: bool


@value
class TimePassed:
    """Only time has passed; send it when `due_ns` has come."""


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
    | CalibrationSaved
    | StoppedOutside
    | EstopKept
    | BodyMeasured
    | PowerSeen
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
    commands: tuple[Command, ...] = ()
    """The commands that the frame carries out, in whole or in part."""
    done: tuple[Command, ...] = ()
    """Those of `commands` that the frame completes."""
    joins: bool = False
    """A repeated Stop that leaves in one call with the step's first Stops, behind them, and needs no preamble."""


@value
class Completed:
    """The request is done without another frame: a newer command replaced its targets, or its Stops are written."""

    request: Request

    @property
    def done(self) -> tuple[Request, ...]:
        """The requests that are completed, as in `Transmit.done`."""
        return (self.request,)


@value
class Rejected:
    """The request takes no further effect, except for its Stops."""

    request: Request
    reason: Reason
    detail: str


@value
class Announce:
    """An event to publish. `legs` are those concerned, ascending."""

    kind: Kind
    detail: str
    source: str | None = None
    key: str | None = None
    legs: tuple[int, ...] = ()
    reason: Reason | None = None


@value
class RequestAnswer:
    """The answer to a LeaseRequest or a ButtonRequest: granted, if there is no `reason`.

    `token` is that of the granted lease or registration. `detail` may also inform a button that is granted.
    """

    reason: Reason | None = None
    detail: str = ""
    token: str | None = field(default=None, repr=False)


@value
class SaveCalibration:
    """Write this calibration to the disk, without delaying anything else. Always answer with CalibrationSaved.

    Until then the old calibration is in force, and command `number` has no answer.
    """

    number: int
    calibration: RobotCalibration


Effect = Transmit | Completed | Rejected | Announce | RequestAnswer | SaveCalibration
Decision = tuple[list[Effect], RequestAnswer]
"""A request's events, and its answer."""


# ---- what became of the requests of a step

Verdict = Reason | Literal["accepted", "coalesced"]
Result = tuple[Request, Verdict, str]
"""A request, its verdict, and why it was rejected (one sentence)."""


def results(effects: Sequence[Effect], failed: Sequence[Transmit] = (), why: str = "") -> list[Result]:
    """Return the requests that these effects end, in their order, each with its verdict.

    `failed` are the frames that were not written, and `why` is the fault. It rejects the commands that these frames
    carry out, and no others: a request without a frame, such as a reset, has taken effect.
    """
    lost: list[Command] = []
    for transmit in failed:
        lost += transmit.commands
    found: list[Result] = []
    for effect in effects:
        match effect:
            case Transmit() | Completed():
                for request in effect.done:
                    if lost and request in lost:
                        found += [(request, Reason.BUS_FAULT, why)]
                    else:
                        coalesced = type(request) is Command and request.coalesced
                        found += [(request, COALESCED if coalesced else ACCEPTED, "")]
            case Rejected():
                found += [(effect.request, effect.reason, effect.detail)]
    return found
