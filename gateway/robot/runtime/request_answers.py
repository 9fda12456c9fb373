"""Requests on the keys that take `get` only. Each key has a `RequestAnswers` and a receiver thread.

The receiver thread parses one request after another and checks its proof, without owning the robot's state. Then an
owner of the state decides and answers.
"""

import datetime as dt
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Final

import zenoh
from pydantic import BaseModel, ValidationError

from gateway.host.settings_table import ButtonSettings
from gateway.robot.core.events import ButtonRequest, LeaseRequest
from gateway.robot.core.intake import is_json
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import Rejection, too_large
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.event_publisher import wall_clock
from gateway.robot.zenoh_io.proofs import Proofs, fresh_token
from gateway.robot.zenoh_io.receiver import OwnersTask
from schemas import keys
from schemas.button import BUTTON_REQUEST, Alive, ButtonAck, Leave, Register
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.lease import LEASE_REQUEST, Challenge, Claim, LeaseAck, Release, Renew
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from gateway.certs.authority import Holder
    from gateway.certs.proof import ProofChecker

PAUSE_S: Final = 0.05
"""The pause between two requests that may write a file: 20 a second, each of which may take a millisecond."""
BY_WILDCARD: Final = Rejection(Reason.INVALID, "a wildcard does not ask this key; name the key")
BAD_ENCODING: Final = Rejection(Reason.BAD_ENCODING, "the encoding must be application/json, or left out")

_LEASE_DOES: Final = '"challenge", "acquire", "ask", "take", "renew" or "release"'
_BUTTON_DOES: Final = '"challenge", "register", "alive" or "leave"'


def why_unread(error: ValidationError, does: str) -> tuple[Reason, str]:
    """Return reason and sentence for an invalid request. `does` lists the valid verbs.

    The sentence repeats no value, which may be secret.
    """
    first = error.errors()[0]
    if first["type"] == "json_invalid":
        return Reason.MALFORMED, "the payload is not JSON"
    # All names in `loc` except an unknown field's come from the schema; pydantic puts the verb first.
    known = [str(part) for part in first["loc"][1:]]
    if first["type"].startswith("union_tag") or not known:
        return Reason.INVALID, f"do must be {does}"
    if first["type"] == "extra_forbidden":
        return Reason.INVALID, "the payload has a field that is not known here"
    return Reason.INVALID, f"{'.'.join(known)} is missing, or not as docs/interface.md defines it"


def payload_of(query: zenoh.Query, most: int) -> bytes | Rejection:
    """Return the payload, or why it is rejected unread: over `most` bytes, a wildcard, or a wrong encoding."""
    payload = query.payload
    if "*" in str(query.key_expr):  # from a program that lists keys
        return BY_WILDCARD
    if payload is not None and len(payload) > most:
        return too_large(len(payload), most)
    if query.encoding is not None and not is_json(str(query.encoding)):
        return BAD_ENCODING
    return b"" if payload is None else payload.to_bytes()


class RequestAnswers(ABC):
    """Answers one key. Its receiver thread calls `note` and `read`; an owner of the state calls the other methods."""

    key: ClassVar[str]
    ack: ClassVar[type[BaseModel]]
    most_bytes: ClassVar[int] = MAX_PAYLOAD_BYTES
    pause_s: ClassVar[float | None] = None
    """Pause after each request; None: no pause."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor

    def note(self, query: zenoh.Query, now_ns: int, reply: Reply) -> OwnersTask:
        """Parse a query received at `now_ns`. Return the task for an owner of the state."""
        source = str(query.source_info.source_id.zid) if query.source_info is not None else None
        payload = payload_of(query, self.most_bytes)
        if isinstance(payload, Rejection):
            task: OwnersTask = partial(self.reject, source, payload.reason, payload.detail, reply)
        else:
            task = self.read(payload, now_ns, reply, source)
        return task if self.pause_s is None else partial(_with_pause, task, self.pause_s)

    @abstractmethod
    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        """Parse a payload received at `now_ns`. Return the task. `source` is the sender if the payload names none."""

    def accepted(self, **fields: object) -> bytes:
        """Return an accepting answer with these fields, as JSON."""
        return self.ack(accepted=True, **fields).model_dump_json().encode()

    def reject(self, source: str | None, reason: Reason, detail: str, reply: Reply, **more: object) -> None:
        """Reject a request and publish the rejection. `more` are further fields of the answer."""
        self._conductor.answers.reject_unread(self.key, source, detail, reason)
        reply(self.ack(accepted=False, reason=reason, detail=detail, **more).model_dump_json().encode())


def _with_pause(task: OwnersTask, pause_s: float) -> float:
    task()
    return pause_s


# ---- lease and buttons: the sender is proved


class LeaseAnswers(RequestAnswers):
    """Answers requests for the lease."""

    key = keys.LEASE
    ack = LeaseAck

    def __init__(
        self,
        conductor: Conductor,
        ttl_ms: float,
        checker: "ProofChecker | None",
        *,
        wall_clock: Callable[[], dt.datetime] = wall_clock,
        fresh: Callable[[], str] = fresh_token,
    ) -> None:
        """Without a `checker`, names are accepted unproved."""
        super().__init__(conductor)
        self._ttl_ms = ttl_ms
        self._proofs = Proofs(checker, wall_clock, fresh)

    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            request = LEASE_REQUEST.validate_json(payload)
        except ValidationError as error:
            return partial(self.reject, source, *why_unread(error, _LEASE_DOES), reply)
        match request:
            case Challenge():
                return partial(reply, self.accepted(nonce=self._proofs.challenge(now_ns)))
            case Claim():
                denied = self._proofs.why_denied(request.proof, request.do, request.source, now_ns)
                if denied is not None:
                    return partial(self.reject, request.source, Reason.LEASE_DENIED, denied, reply)
                fresh = self._proofs.fresh()
                asked = LeaseRequest(request.do, request.source, self._proofs.wanted, fresh_token=fresh)
            case Renew():
                asked = LeaseRequest("renew", token=request.lease)
            case Release():
                asked = LeaseRequest("release", token=request.lease, to=request.to)
        return partial(self.ask, asked, reply)

    def ask(self, request: LeaseRequest, reply: Reply) -> None:
        """Let the supervisor decide. Answer after its frames are written."""
        answer = self._conductor.ask(request).answer
        if answer is None:  # the service has ended
            return
        lease = self._conductor.supervisor.lease
        if answer.reason is not None:
            self.reject(request.source, answer.reason, answer.detail, reply, holder=lease.holder)
            return
        verified = None if lease.holder is None else lease.verified
        reply(self.accepted(lease=answer.token, holder=lease.holder, ttl_ms=self._ttl_ms, verified=verified))


class ButtonAnswers(RequestAnswers):
    """Answers requests of stop buttons."""

    key = keys.BUTTON
    ack = ButtonAck

    def __init__(
        self,
        conductor: Conductor,
        settings: ButtonSettings,
        checker: "ProofChecker | None",
        *,
        fresh: Callable[[], str] = fresh_token,
    ) -> None:
        """Without a `checker`, names are accepted unproved."""
        super().__init__(conductor)
        self._settings = settings
        self._proofs = Proofs(checker, wall_clock, fresh, watching=True)

    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            request = BUTTON_REQUEST.validate_json(payload)
        except ValidationError as error:
            return partial(self.reject, source, *why_unread(error, _BUTTON_DOES), reply)
        match request:
            case Challenge():
                return partial(reply, self.accepted(nonce=self._proofs.challenge(now_ns)))
            case Register():
                denied = self._proofs.why_denied(request.proof, request.do, request.source, now_ns)
                if denied is not None:
                    return partial(self.reject, request.source, Reason.BUTTON_DENIED, denied, reply)
                holder = self._proofs.holder(request.proof)
                asked = ButtonRequest(
                    "register",
                    now_ns,
                    request.source,
                    None if holder is None else " ".join(holder),
                    self._counts(request.source, holder),
                    sent_ms=request.sent_ms,
                    fresh_token=self._proofs.fresh(),
                )
            case Alive():
                asked = ButtonRequest(
                    "alive", now_ns, token=request.button, count=request.count, sent_ms=request.sent_ms
                )
            case Leave():
                asked = ButtonRequest("leave", now_ns, token=request.button)
        return partial(self.ask, asked, reply)

    def ask(self, request: ButtonRequest, reply: Reply) -> None:
        """Let the supervisor decide. Answer after its frames are written."""
        answer = self._conductor.ask(request).answer
        if answer is None:  # the service has ended
            return
        if answer.reason is not None:
            self.reject(request.source, answer.reason, answer.detail, reply)
            return
        timeout_ms, required = self._settings.timeout_ms, self._settings.required
        alive = self._conductor.supervisor.buttons.alive
        detail = answer.detail or None
        reply(self.accepted(detail=detail, button=answer.token, timeout_ms=timeout_ms, alive=alive, required=required))

    def _counts(self, source: str, holder: "Holder | None") -> bool:
        """Return whether `buttons.names` has the button's person (`anna` of `anna/phone`) or its certificate's role."""
        person = source.partition("/")[0] if holder is None else holder.name
        names = self._settings.names
        return not names or person in names or (holder is not None and holder.role in names)
