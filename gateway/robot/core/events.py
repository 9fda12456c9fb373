"""The supervisor's inputs (events) and outputs (effects)."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Final, Literal, final

from gateway.model.black_box import ACCEPTED, COALESCED
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OP_STOP, Frame, ServoOp
from gateway.robot.core.message import Reply, Verb, value
from gateway.words.text import legs_named
from schemas.calibration import CalibrationCommand
from schemas.robot import LEGS
from schemas.words import Cause, Kind, Reason

Targets = tuple[tuple[int, ServoOp], ...]
"""Operations for servos, by their ids."""

_GET, _REPEAT = Verb.GET, Cause.REPEAT  # see `frames.OP_STOP`

Sender = tuple[str | None, str | None]
"""Who sent a request: a name, and the Zenoh id of the session. Two requests are of one sender if both are equal: a
console's pages share a session, and anybody may claim a name."""
NOBODY: Final[Sender] = (None, None)

# ---- what is answered


@dataclass(eq=False)
class Request:
    """A request: one object from payload to answer. The payload's reader makes it; the state's owner changes it.

    It has no slots: with them, each request would be given the defaults of what few requests have.
    """

    targets: Targets = ()
    _: KW_ONLY
    key: str = ""
    source: str | None = None
    """The sender's name, for people."""
    source_id: str | None = None
    """The Zenoh id of the sender's session; None if the message does not contain it."""
    sent_ms: float | None = None
    lease: str | None = field(default=None, repr=False)
    reply: Reply | None = field(default=None, repr=False)
    verb: Verb = Verb.PUT
    received_ns: int = 0
    number: int = 0
    """The request's number for supervisor and black box, from 1 on; 0: rejected before the supervisor."""
    written: tuple[int, ...] = field(init=False, default=())
    """The legs with a written frame of the request. If it is rejected afterwards, its answer names them."""
    stopped: tuple[int, ...] = field(init=False, default=())
    """Servos that the request stops though it is rejected."""
    moves: Targets = field(init=False, default=())
    """A command's targets that are no Stops."""

    @property
    def sender(self) -> Sender:
        return self.source, self.source_id

    @property
    def servo_ids(self) -> Iterable[int]:
        """The servos that the request names."""
        return (servo_id for servo_id, _ in self.targets)

    @property
    def only_stops(self) -> bool:
        """Whether the request stops servos and does nothing else. A reset stops none."""
        return bool(self.targets) and all(op.op is OP_STOP for _, op in self.targets)


@final
@dataclass(eq=False, kw_only=True)
class Command(Request):
    """A valid command for servos, and how much of it is still to be written."""

    lost: bool = False
    """Whether these are Stops for lost messages, sent by no client."""
    rejected: "Rejected | None" = field(default=None, repr=False)
    """The rejection, if the command was rejected before the supervisor: only its Stops are carried out. The Stops of an
    unreadable message are such a command; its rejection answers another request."""
    frames: tuple[Frame, ...] = ()
    """The frames of a command that only moves servos, by which it may go the usual way; (): it goes the general way."""
    left: int = field(init=False)
    """The number of targets that are not yet written or replaced by a newer command's."""
    coalesced: bool = field(init=False, default=False)
    """Whether a newer command has replaced one of its targets."""

    def __post_init__(self) -> None:
        self.left = len(self.targets)
        self.moves = self.targets
        if not self.frames:
            self.moves = tuple([target for target in self.targets if target[1].op is not OP_STOP])

    @property
    def by_leg(self) -> dict[int, Targets]:
        found: dict[int, Targets] = {}
        for target in self.targets:
            leg = target[0] // 10
            found[leg] = (*found.get(leg, ()), target)
        return found

    @property
    def stops(self) -> Targets:
        return tuple(target for target in self.targets if target[1].op is OP_STOP)

    @property
    def channel(self) -> str:
        """Verb and key. Commands of one channel arrive in order; between channels the order is unknown."""
        return f"{'get' if self.verb is _GET else 'put'} {self.key}"


@final
@dataclass(eq=False, kw_only=True)
class Reset(Request):
    """Leaves the emergency stop number `estop`; None: the request has no number."""

    estop: int | None = None


@dataclass(eq=False, kw_only=True)
class Calibrate(Request):
    """Changes the calibration."""

    change: CalibrationCommand

    @property
    def servo_ids(self) -> Iterable[int]:
        return map(int, (*self.change.servos, *self.change.landing))


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
    """The event that reports the fault, if it is the first since the bus was opened."""


@value
class BodyMeasured:
    """The body's tilt in hundredths of a degree (None: unknown), and the battery's voltage in mV, as measured."""

    tilt_cdeg: int | None
    battery_mv: int


@value
class PowerSeen:
    """The power board's report on the servos' supply."""

    alive: bool
    refused: tuple[tuple[int, str], ...] = ()
    """Servos that the board will not power before a reset, and why."""
    fed: frozenset[int] = frozenset()
    """Servos that the board has confirmed to power since the latest Cut or Feed."""
    lost: frozenset[int] = frozenset()
    """Servos that the board no longer powers, though it should."""
    doubt: str = ""
    """Why a servo that should be off may be on, or ""."""
    taken: frozenset[int] = frozenset()
    """Those of `lost` that another node, or the board by itself, has switched off."""
    supplied: frozenset[int] = frozenset()
    """Servos that the board powers, by its last answer."""
    drew: tuple[tuple[int, str], ...] = ()
    """Stopped servos that draw current, each with a sentence."""
    rests: bool = False
    """Whether the current of a powered servo that does not run shows that it rests."""


@value
class EmergencyStop:
    """Stops all six legs, and latches."""

    source: str | None = None
    key: str | None = None
    source_id: str | None = None


@value
class LeaseRequest:
    """A request for the lease. `fresh_token` is 128 random bits for a new lease."""

    do: Literal["acquire", "ask", "take", "renew", "release"]
    source: str | None = None
    token: str | None = field(default=None, repr=False)
    to: str | None = None
    fresh_token: str = field(default="", repr=False)
    source_id: str | None = None


@value
class ButtonRequest:
    """A button registers, checks in, or leaves. `fresh_token` is 128 random bits for a registration.

    `holder` is the certificate that has proved `source` (None: names are not proved). `counts`: the button counts
    towards `buttons.required`.
    """

    do: Literal["register", "alive", "leave"]
    received_ns: int
    source: str | None = None
    holder: str | None = None
    counts: bool = True
    token: str = field(default="", repr=False)
    count: int = 0
    sent_ms: float | None = None
    fresh_token: str = field(default="", repr=False)
    source_id: str | None = None


@value
class CalibrationSaved:
    """The calibration of SaveCalibration `number` is on the disk; with a `fault`, the old one still is."""

    number: int
    fault: str | None = None


@value
class StoppedOutside:
    """`stop-servos` stops all servos past the gateway, or (not `at_work`) has ended and sends no further Stop."""

    at_work: bool


@value
class EstopKept:
    """The earlier run's latest emergency stop (`number` 0: none). It is sent once if `Rules.estop_kept`.

    `engaged`: no reset has left it.
    """

    number: int
    engaged: bool


@value
class TimePassed:
    """Only time has passed. Send this event at `due_ns`."""


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
    """Whether this repeated Stop leaves in one call with the step's first Stops, after them and without a preamble."""


@value
class Completed:
    """The request is done without a further frame: newer commands replaced its targets, or its Stops are written."""

    request: Request

    @property
    def done(self) -> tuple[Request, ...]:
        """The completed requests, as in `Transmit.done`."""
        return (self.request,)


@value
class Rejected:
    """The request has no further effect, except for its Stops."""

    request: Request
    reason: Reason
    detail: str


@value
class Announce:
    """An event to publish. `legs` are those concerned, ascending; none: all, or no leg in particular."""

    kind: Kind
    detail: str = ""
    """What is so whether or not the step's frames can be written. Without it, there is no event if the bus fails."""
    source: str | None = None
    key: str | None = None
    legs: tuple[int, ...] = ()
    reason: Reason | None = None
    done: str = ""
    """What the step's frames for these legs do. It follows `detail` once they are written."""

    source_id: str | None = None
    cause: Cause | None = None
    """Of `legs_stopped`."""

    def outcome(self, unwritten: Collection[int], fault: object) -> "Announce | None":
        """Return the event after its step, or None if there is none.

        `fault`: of the bus in this step, for which the legs `unwritten` did not get all their frames.
        """
        if not self.done:
            return self
        if not self.detail and fault is not None:
            return None
        done, failed = self.done, sorted(set(unwritten) & set(self.legs or LEGS))
        if failed:
            done = f"frames for {legs_named(failed)} could not be written: {fault}"
        return replace(self, detail=f"{self.detail}; {done}" if self.detail else done, done="")


@value
class RequestAnswer:
    """The answer to a LeaseRequest or a ButtonRequest; without a `reason` it is granted, with this `token`.

    A granted button may get a `detail`, too.
    """

    reason: Reason | None = None
    detail: str = ""
    token: str | None = field(default=None, repr=False)


@value
class SaveCalibration:
    """Write this calibration to the disk, in the background, and answer with CalibrationSaved in any case.

    Until then the old calibration is in force, and request `number` has no answer.
    """

    number: int
    calibration: RobotCalibration


@value
class Cut:
    """Power no servos but `keep` from now on. `everything`: cut also those that another node has powered."""

    keep: frozenset[int]
    everything: bool


@value
class Feed:
    """Power exactly these servos, after the step's frames.

    Each has the wire angle at which supply may start it (hundredths of a degree); None: it runs.
    """

    servos: Mapping[int, int | None]


@value
class ClearErrors:
    """Have the power board power blocked servos again, once they are fed."""


Effect = Transmit | Completed | Rejected | Announce | RequestAnswer | SaveCalibration | Cut | Feed | ClearErrors


def batches(effects: Iterable[Effect]) -> tuple[list[Transmit], list[Transmit], list[Transmit]]:
    """Return a step's frames as they leave, each batch in one call: first Stops, repeated Stops, moves.

    Repeated Stops have a preamble, for which a first Stop must not wait. The repeats for legs at rest join the first
    batch, after its own Stops.
    """
    first: list[Transmit] = []
    repeated: list[Transmit] = []
    moves: list[Transmit] = []
    for effect in effects:
        if type(effect) is Transmit:
            stops = repeated if effect.cause is _REPEAT and not effect.joins else first
            (stops if effect.frame.is_stop else moves).append(effect)
    return first, repeated, moves


# ---- the outcome of a step's requests

Verdict = Reason | Literal["accepted", "coalesced"]
Result = tuple[Request, Verdict, str]
"""A request, its verdict, and why it was rejected (one sentence)."""


def results(effects: Sequence[Effect], failed: Sequence[Transmit] = (), why: str = "") -> list[Result]:
    """Return the requests that these effects end, in their order, each with its verdict.

    `failed` are the frames that were not written, because of the fault `why`, which rejects the commands in these
    frames. Requests without a frame, such as a reset, have taken effect.
    """
    lost = [command for transmit in failed for command in transmit.commands]
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
