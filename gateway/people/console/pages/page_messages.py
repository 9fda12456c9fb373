"""The messages between a page and the console on the WebSocket, as JSON text; `type` states which message it is.

Messages from a page are strict and closed, and a command's payload is what `schemas` accepts on the same key. Anything
else ends the WebSocket with code 1008 and the reason. Messages to a page are open: it ignores fields and messages that
it does not know.

A page sends `AliveMessage` when it opens and each second. So the console knows the page's clock before the first
command, and rejects what was delayed on its way. Only the page itself renews its lease.
"""

from typing import Annotated, Any, Final, Literal, Self, get_args

from pydantic import BaseModel, Field, TypeAdapter, model_validator
from pydantic_core import to_json

from gateway.people.walking.gaits import GAITS
from gateway.people.watching.dangers import tone_of
from schemas import keys
from schemas.ack import Ack
from schemas.command import Closed, EstopNumber, LegCommand, LegsCommand, MoveCommand, SentMs, Source, StopCommand
from schemas.event import Event

MAX_MESSAGE_BYTES: Final = 8192
"""Limit of a message from a page: a payload of at most 4096 (`schemas`), and the fields around it."""
MAX_ID: Final = 2**53


Id = Annotated[int, Field(ge=0, le=MAX_ID, description="the page's own number; the answer repeats it")]
Role = Literal["operator", "button", "observer"]
"""The rights of a page: everything; watch, stop and be a stop button; only watch."""
ROLES: Final[tuple[Role, ...]] = get_args(Role)


def least(first: Role, second: Role) -> Role:
    """The role that may do less."""
    return max(first, second, key=ROLES.index)


CalibrateVerb = Literal[
    "open", "test", "leave", "jog", "stands_at", "wrong_way", "lowest_here", "highest_here", "full_range", "as_drawn",
    "undo", "write", "landing", "accept_default",
]  # fmt: skip
Speed = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Gait = Annotated[str, Field(pattern=f"^({'|'.join(GAITS)})$")]
_WITH_ANGLE: Final = frozenset({"test", "jog", "stands_at"})

_BY_THE_CONSOLE: Final = frozenset({"source", "sent_ms", "lease"})
_PAYLOADS: Final[dict[keys.Target, tuple[type[BaseModel], ...]]] = {
    keys.Target.LEG: (LegCommand,),
    keys.Target.SERVO: (MoveCommand, StopCommand),
    keys.Target.LEGS: (LegsCommand,),
}


# ---- from the page


class AliveMessage(Closed):
    """Sent when the page opens, and each second: its monotonic clock in ms (`performance.now()`)."""

    type: Literal["alive"]
    now_ms: SentMs


class CommandRequest(Closed):
    """A command for one leg, one servo or several legs; with `id` it is answered by an ack, else only published.

    `sent_ms` is by the page's clock, as in `AliveMessage`. The console adds the page's name and lease.
    """

    type: Literal["command"]
    key: Annotated[str, Field(max_length=32)]
    payload: LegCommand | LegsCommand | MoveCommand | StopCommand
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
    """The emergency stop, now; answered by `stop` until it is confirmed."""

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
    do: Literal["acquire", "ask", "take", "renew", "release"]
    to: Source | None = None

    @model_validator(mode="after")
    def _only_release_has_a_receiver(self) -> Self:
        if self.to is not None and self.do != "release":
            raise ValueError(f"{self.do} has no `to`")
        return self


class CalibrateRequest(Closed):
    """One step of the calibration guide, which the console keeps for this WebSocket; it moves no servo.

    The page's own commands move the servo under test, to `command_deg` of the answer. `deg` is
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


class CameraMessage(Closed):
    """The camera that the page shows from now on; null: none. A page that shows one moves nothing by an old picture."""

    type: Literal["camera"]
    shown: Annotated[str, Field(max_length=20)] | None


class StopButtonRequest(Closed):
    """Register, check in or leave as a stop button (`hexapod/button/cmd`); answered by `button`.

    Each check-in comes from the page's own timer: the console adds the token, and sends none by itself.
    """

    type: Literal["button"]
    id: Id
    do: Literal["register", "alive", "leave"]
    sent_ms: SentMs


class PlainRequest(Closed):
    """A request without content.

    `link_for`: a link for a second device, such as a phone; answered by a message of that type.
    `upright`: set a robot that is simulated with physics upright; answered by an ack.
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
    | CameraMessage
    | PlainRequest
)
FROM_PAGE: Final[TypeAdapter[FromPage]] = TypeAdapter(Annotated[FromPage, Field(discriminator="type")])


# ---- to the page

Message = dict[str, Any]
"""A message to a page, with the fields that `types.js` lists for its `type`. Values may be reports."""


def json_of(message: Message) -> str:
    return to_json(message, inf_nan_mode="null").decode()


def ack_message(request_id: int, took_ms: float = 0.0, ack: Ack | None = None, error: str | None = None) -> Message:
    """Return the answer to a command or reset. Without an `ack`, `error` states why none came."""
    return {"type": "ack", "id": request_id, "took_ms": took_ms, "ack": ack, "error": error}


def event_message(event: Event, left_out: int = 0) -> Message:
    """Return one event. `left_out`: how many before it were not sent."""
    return {"type": "event", "event": event, "left_out": left_out, "tone": tone_of(event.kind)}


def link_message(status: Literal["connected", "silent", "gone"], detail: str = "") -> Message:
    """Return the console's link to the gateway. `detail`: why it is not connected, one line for each host."""
    return {"type": "link", "status": status, "detail": detail}


def walk_message(press: int, detail: str, **report: Any) -> Message:
    """Return the progress of the page's walk; without a `report` it is over. `detail`: why it ended, or waits."""
    return {"type": "walk", "press": press, "id": None, "posture": None, "detail": detail, **report}
