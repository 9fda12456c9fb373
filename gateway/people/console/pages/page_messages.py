"""The messages between a page and the console on the WebSocket, as JSON text; `type` states which message it is.

Messages from a page are strict and closed, and a command's payload is what `schemas` accepts on the same key. Anything
else ends the WebSocket with code 1008 and the reason. Messages to a page are open: it ignores fields and messages that
it does not know.

A page sends `AliveMessage` when it opens and each second. So the console knows the page's clock before the first
command, and rejects what was delayed on its way. Only the page itself renews its lease.
"""

from typing import Annotated, Any, Final, Literal, Self, get_args

from pydantic import AfterValidator, BaseModel, Discriminator, Field, Tag, TypeAdapter, model_validator

from gateway.people.client.dangers import Tone
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.motion import Posture
from schemas import keys
from schemas.calibration import ServoCalibration
from schemas.command import Closed, EstopNumber, LegCommand, LegsCommand, MoveCommand, SentMs, Source, StopCommand
from schemas.telemetry import Ack, BodyReport, Event, GatewayState, Report, Telemetry

MAX_MESSAGE_BYTES: Final = 8192
"""Limit of a message from a page: a payload of at most 4096 (`schemas`), and the fields around it."""
MAX_ID: Final = 2**53


def _known_gait(name: str) -> str:
    if name not in GAITS:
        raise ValueError(f"the gaits are {', '.join(GAITS)}")
    return name


Id = Annotated[int, Field(ge=0, le=MAX_ID, description="the page's own number; the answer repeats it")]
Role = Literal["operator", "button", "observer"]
"""The rights of a page: everything; watch, stop and be a stop button; only watch."""
ROLES: Final[tuple[Role, ...]] = get_args(Role)


def least(first: Role, second: Role) -> Role:
    """The role that may do less."""
    return max(first, second, key=ROLES.index)


LeaseVerb = Literal["acquire", "ask", "take", "renew", "release"]
LeaseEnd = Literal["page_silent", "taken", "gateway"]
"""Why a page lost the lease: it asked for none in time; somebody has taken it; the gateway ended it or was silent."""
ButtonVerb = Literal["register", "alive", "leave"]
CalibrateVerb = Literal[
    "open", "test", "leave", "jog", "stands_at", "wrong_way", "lowest_here", "highest_here", "full_range", "as_drawn",
    "undo", "write", "landing", "accept_default",
]  # fmt: skip
Speed = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Gait = Annotated[str, Field(max_length=16), AfterValidator(_known_gait)]
_WITH_ANGLE: Final = frozenset({"test", "jog", "stands_at"})

_BY_THE_CONSOLE: Final = frozenset({"source", "sent_ms", "lease"})
_PAYLOADS: Final[dict[keys.Target, tuple[type[BaseModel], ...]]] = {
    keys.Target.LEG: (LegCommand,),
    keys.Target.SERVO: (MoveCommand, StopCommand),
    keys.Target.LEGS: (LegsCommand,),
}


def _shape(payload: Any) -> str:
    """The tag of the payload to validate it as."""
    if isinstance(payload, dict):
        if "legs" in payload:
            return "legs"
        if "op" in payload:
            return "stop" if payload["op"] == "stop" else "move"
    return "leg"


Payload = Annotated[
    Annotated[LegCommand, Tag("leg")]
    | Annotated[LegsCommand, Tag("legs")]
    | Annotated[MoveCommand, Tag("move")]
    | Annotated[StopCommand, Tag("stop")],
    Discriminator(_shape),
]


# ---- from the page


class AliveMessage(Closed):
    """Sent when the page opens, and each second: its monotonic clock in ms (`performance.now()`)."""

    type: Literal["alive"]
    now_ms: SentMs


class CommandRequest(Closed):
    """A command for one leg, one servo or several legs; with `id` it is answered by `AckMessage`, else only published.

    `sent_ms` is by the page's clock, as in `AliveMessage`. The console adds the page's name and lease.
    """

    type: Literal["command"]
    key: Annotated[str, Field(max_length=32)]
    payload: Payload
    sent_ms: SentMs
    id: Id | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        target = keys.parse(self.key).target
        if not isinstance(self.payload, _PAYLOADS.get(target, ())):
            raise ValueError(f"the payload does not belong to {self.key}")
        own = self.payload.model_fields_set & _BY_THE_CONSOLE
        if own:
            raise ValueError(f"the console itself sets {', '.join(sorted(own))}")
        return self

    @property
    def only_stops(self) -> bool:
        """Whether it starts and sets nothing: then it is accepted at any age, and repeated until it is answered."""
        match self.payload:
            case LegsCommand(legs=legs):
                moves = [setpoint for leg in legs.values() for setpoint in leg.servos]
            case LegCommand(servos=servos):
                moves = list(servos)
            case single:
                moves = [single]
        return all(move.op == "stop" for move in moves)


class StopAllRequest(Closed):
    """The emergency stop, now; answered by `Stopping` until it is confirmed."""

    type: Literal["stop_all"]
    id: Id
    button: bool = False
    """Requested by a page that is a stop button, under the button's name."""


class ResetRequest(Closed):
    """End the emergency stop of this number: the one that the page showed when its user agreed."""

    type: Literal["reset"]
    id: Id
    estop: EstopNumber
    sent_ms: SentMs


class DriveRequest(Closed):
    """Acquire, renew or release the lease of this WebSocket; `to`: release it to this person."""

    type: Literal["lease"]
    id: Id
    do: LeaseVerb
    to: Source | None = None

    @model_validator(mode="after")
    def _only_release_has_a_receiver(self) -> Self:
        if self.to is not None and self.do != "release":
            raise ValueError(f"{self.do} has no `to`")
        return self


class CalibrateRequest(Closed):
    """One step of the calibration guide, which the console keeps for this WebSocket; it moves no servo.

    The page's own commands move the servo under test, to `command_deg` of the answer (`CalibrationMessage`). `deg` is
    the angle at which a test begins, the angle to jog by, or the measured angle.
    """

    type: Literal["calibrate"]
    id: Id
    do: CalibrateVerb
    servo: Annotated[int, Field(ge=11, le=63)] | None = None
    deg: Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.deg is not None) != (self.do in _WITH_ANGLE):
            raise ValueError(f"{self.do} has {'no' if self.deg is not None else 'a'} `deg`")
        if (self.servo is not None) != (self.do == "test"):
            raise ValueError(f"{self.do} has {'no' if self.servo is not None else 'a'} `servo`")
        return self


class WalkWish(Closed):
    """The walk that the page wants, sent 20 times a second while the robot walks or stands; used once (`page_walk.py`).

    `press` is the number of the press, of a button or stick, that it belongs to; it grows. Velocities are the body's.
    `height_m` null: the usual height. `sits`: sit down, and stop the servos. Each wish is complete, so a lost one
    matters little.
    """

    type: Literal["walk"]
    id: Id
    press: Id
    sent_ms: SentMs
    forward_m_s: Speed = 0.0
    left_m_s: Speed = 0.0
    turn_rad_s: Annotated[float, Field(ge=-4, le=4, allow_inf_nan=False)] = 0.0
    gait: Gait = "tripod"
    height_m: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] | None = None
    sits: bool = False


class StopButtonRequest(Closed):
    """Register, check in or leave as a stop button (`hexapod/button/cmd`); answered by `StopButtonMessage`.

    Each check-in comes from the page's own timer: the console adds the token, and sends none by itself.
    """

    type: Literal["button"]
    id: Id
    do: ButtonVerb
    sent_ms: SentMs


class PlainRequest(Closed):
    """A request without content.

    `link_for`: a link for a second device, such as a phone; answered by `LinkForMessage`.
    `upright`: set a robot that is simulated with physics upright; answered by `AckMessage`.
    """

    type: Literal["link_for", "upright"]
    id: Id


FromPage = (
    AliveMessage
    | CommandRequest
    | StopAllRequest
    | ResetRequest
    | DriveRequest
    | CalibrateRequest
    | WalkWish
    | StopButtonRequest
    | PlainRequest
)
FROM_PAGE: Final[TypeAdapter[FromPage]] = TypeAdapter(Annotated[FromPage, Field(discriminator="type")])


# ---- to the page


class Hello(Report):
    """The first message. `source` is this page's name in state and events (`anna (page 3)`), `person` its holder's.

    `names` are `source` and those of the pages before it in its tab, on which it drives on.

    `geometry` is the robot's, as in its geometry file. `lying`: each servo's angle when it lies on its belly, as in
    commands; empty where it cannot lie. `gaits` are the names that a walk may have.
    """

    type: Literal["hello"] = "hello"
    role: Role
    person: str
    source: str
    names: tuple[str, ...] = ()
    version: str
    geometry: dict[str, Any]
    lying: dict[int, float] = Field(default_factory=dict)
    gaits: tuple[str, ...] = tuple(GAITS)
    last_id: int = 0
    """The last id of the page that was reloaded in this tab: the new page's numbers begin after it."""


class StateMessage(Report):
    """The gateway's newest state, received `age_ms` ago; older ones may have been left out.

    `now`: what the robot does according to it, in one sentence without its full stop. `whole`: its six legs start and
    stop only together. `power`: how the power board feeds the servos, in a few words; `unconfirmed`: the sentence to
    show in red while it does not confirm a Stop; both empty where there is none.
    """

    type: Literal["state"] = "state"
    age_ms: float
    now: str = ""
    whole: bool = False
    power: str = ""
    unconfirmed: str = ""
    state: GatewayState


class LinkMessage(Report):
    """The console's link to the gateway. `connected`: states come; `silent`: linked, but no state comes.

    `gone`: no gateway is reached. `detail` states why, one line for each host; empty while connected.
    """

    type: Literal["link"] = "link"
    status: Literal["connected", "silent", "gone"]
    detail: str = ""


class BodyMessage(Report):
    """The pose of a body that is simulated with physics; older ones may have been left out."""

    type: Literal["body"] = "body"
    body: BodyReport


class TelemetryMessage(Report):
    """The robot's measurements, at most 10 times a second; further values are dropped."""

    type: Literal["telemetry"] = "telemetry"
    telemetry: Telemetry


class EventMessage(Report):
    """One event; after `Hello` the page is sent the newest ones. `left_out`: how many before it were not sent."""

    type: Literal["event"] = "event"
    event: Event
    left_out: int = 0
    tone: Tone = "plain"


class AckMessage(Report):
    """The answer to a command or reset. `ack` is null if none came, and `error` states why."""

    type: Literal["ack"] = "ack"
    id: int
    took_ms: float
    ack: Ack | None = None
    error: str | None = None


class Stopping(Report):
    """The progress of a `StopAllRequest`: sent at once, after each unanswered attempt, and when it is confirmed.

    While `answered` is false the console goes on requesting it. `power`: the power board's confirmation, which ends a
    sentence.
    """

    type: Literal["stop"] = "stop"
    id: int
    asked_ms_ago: float
    answered: bool
    attempts: int
    stop_frames: int | None = None
    latency_us: float | None = None
    estop: int | None = None
    power: str = ""
    error: str | None = None


class LeaseMessage(Report):
    """Whether this WebSocket has the lease: the answer to `DriveRequest` (with its `id`), or sent when it is lost.

    The state names any other holder. A page renews at a third of `ttl_ms`. `end`: why it was lost, `silent_s` after it
    was last granted; the page words it.
    """

    type: Literal["lease"] = "lease"
    mine: bool
    id: int | None = None
    accepted: bool | None = None
    reason: str | None = None
    detail: str | None = None
    holder: str | None = None
    verified: bool | None = None
    ttl_ms: float | None = None
    end: LeaseEnd | None = None
    silent_s: float | None = None


class WalkMessage(Report):
    """The progress of the page's walk: ten times a second while it lasts, and once when it is over (`posture` null).

    `now`: what the robot does, in one sentence without its full stop, by the gateway's newest state and this walk.
    `id` is the newest wish that was used. `waits`: the page's newest press is used up, and moves nothing any more.
    `commanded` and `scaled` (what the legs can do of it; `limit` states why) are forward and left in m/s, and the turn
    in rad/s. `lost`: legs that somebody else has stopped. `ground`: what a walk by sensors feels, and how far it has
    levelled itself. `detail`: why it ended, or waits.
    """

    type: Literal["walk"] = "walk"
    press: int
    id: int | None = None
    posture: Posture | None = None
    now: str = ""
    gait: str | None = None
    height_m: float | None = None
    commanded: list[float] = Field(default_factory=list)
    scaled: list[float] = Field(default_factory=list)
    limit: str = ""
    lost: list[int] = Field(default_factory=list)
    ground: str = ""
    waits: bool = True
    detail: str = ""


class StopButtonMessage(Report):
    """The answer to `StopButtonRequest`. `accepted` null: no gateway answered, and `detail` states why."""

    type: Literal["button"] = "button"
    id: int
    do: str
    accepted: bool | None = None
    reason: str | None = None
    detail: str | None = None
    name: str | None = None
    timeout_ms: float | None = None
    alive: int | None = None
    required: int | None = None


class LinkForMessage(Report):
    """A link that works once, and its QR code: one text of 0 (light) and 1 (dark) for each row."""

    type: Literal["link_for"] = "link_for"
    id: int
    url: str | None = None
    rows: list[str] = Field(default_factory=list)
    error: str | None = None


class Draft(ServoCalibration):
    """One servo's calibration as the page would write it; `changed`: it differs from the one in force."""

    changed: bool


class CalibrationMessage(Report):
    """The answer to `CalibrateRequest`: the guide's state. `error`: what was not done and why, in one sentence.

    `shown_deg` is the angle of the servo under test by the draft; `command_deg` the same by the calibration in force,
    which is what the page commands.
    """

    type: Literal["calibration"] = "calibration"
    id: int
    revision: int | None = None
    servos: dict[int, Draft] = Field(default_factory=dict)
    landing: dict[int, float] = Field(default_factory=dict)
    servo: int | None = None
    shown_deg: float | None = None
    command_deg: float | None = None
    error: str | None = None
    said: str | None = None
