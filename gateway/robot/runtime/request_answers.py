"""Requests on the keys that take `get` only. Each key has a `RequestAnswers` and a receiver thread.

The receiver thread parses one request after another and checks its proof, without owning the robot's state. Then an
owner of the state decides and answers.
"""

from abc import ABC, abstractmethod
from functools import partial
from typing import Any, ClassVar, Final

import zenoh
from pydantic import BaseModel, TypeAdapter, ValidationError

from gateway.robot.core.events import ButtonRequest, LeaseRequest, RequestAnswer
from gateway.robot.core.intake import is_json
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import BAD_ENCODING, Rejection, explain, too_large
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.zenoh_io.proofs import Proofs
from gateway.robot.zenoh_io.receiver import OwnersTask
from schemas import keys
from schemas.button import BUTTON_REQUEST, Alive, ButtonAck, Leave, Register
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.lease import LEASE_REQUEST, Challenge, Claim, LeaseAck, Release, Renew
from schemas.telemetry import Reason

PAUSE_S: Final = 0.05
"""The pause between two requests that may write a file: 20 a second, each of which may take a millisecond."""
_BY_WILDCARD: Final = Rejection(Reason.INVALID, "a wildcard does not ask this key; name the key")


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
        payload, unread = query.payload, None
        if "*" in str(query.key_expr):  # from a program that lists keys
            unread = _BY_WILDCARD
        elif payload is not None and len(payload) > self.most_bytes:
            unread = too_large(len(payload), self.most_bytes)
        elif query.encoding is not None and not is_json(str(query.encoding)):
            unread = BAD_ENCODING
        if unread is not None:
            task: OwnersTask = partial(self.reject, source, unread.reason, unread.detail, reply)
        else:
            task = self.read(b"" if payload is None else payload.to_bytes(), now_ns, reply, source)
        return task if self.pause_s is None else partial(_with_pause, task, self.pause_s)

    @abstractmethod
    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        """Parse a payload received at `now_ns`. Return the task. `source` is the sender if the payload names none."""

    def accepted(self, **fields: object) -> bytes:
        """Return an accepting answer with these fields, as JSON."""
        return self.ack(accepted=True, **fields).model_dump_json().encode()

    def reject(self, source: str | None, reason: Reason, detail: str, reply: Reply, **more: object) -> None:
        """Reject a request and publish the rejection. `more` are further fields of the answer."""
        self._conductor.executor.reject_unread(self.key, source, detail, reason)
        reply(self.ack(accepted=False, reason=reason, detail=detail, **more).model_dump_json().encode())


def _with_pause(task: OwnersTask, pause_s: float) -> float:
    task()
    return pause_s


# ---- lease and buttons: the sender is proved


class _ProvedAnswers(RequestAnswers):
    """Answers requests whose sender may have to prove its name."""

    schema: ClassVar[TypeAdapter[Any]]
    denied: ClassVar[Reason]
    """Why a request without a valid proof is rejected."""

    def __init__(self, conductor: Conductor, proofs: Proofs) -> None:
        super().__init__(conductor)
        self._proofs = proofs

    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            request = self.schema.validate_json(payload)
        except ValidationError as error:
            unread = explain(error)
            return partial(self.reject, source, unread.reason, unread.detail, reply)
        if isinstance(request, Challenge):
            return partial(reply, self.accepted(nonce=self._proofs.challenge(now_ns)))
        if isinstance(request, Claim | Register):
            denied = self._proofs.why_denied(request.proof, request.do, request.source, now_ns)
            if denied is not None:
                return partial(self.reject, request.source, self.denied, denied, reply)
        return partial(self.ask, self._event(request, now_ns), reply)

    @abstractmethod
    def _event(self, request: Any, now_ns: int) -> Any:
        """Return the supervisor's event for a request whose sender is proved."""

    @abstractmethod
    def _granted(self, answer: RequestAnswer) -> dict[str, object]:
        """Return the fields of an accepting answer."""

    def ask(self, request: Any, reply: Reply) -> None:
        """Let the supervisor decide. Answer after its frames are written."""
        answer = self._conductor.ask(request).to_do
        if not isinstance(answer, RequestAnswer):  # the service has ended
            return
        if answer.reason is None:
            reply(self.accepted(**self._granted(answer)))
            return
        more = {"holder": self._conductor.supervisor.lease.holder} if isinstance(request, LeaseRequest) else {}
        self.reject(request.source, answer.reason, answer.detail, reply, **more)


class LeaseAnswers(_ProvedAnswers):
    key = keys.LEASE
    ack = LeaseAck
    schema = LEASE_REQUEST
    denied = Reason.LEASE_DENIED

    def _event(self, request: Claim | Renew | Release, now_ns: int) -> LeaseRequest:  # noqa: ARG002
        match request:
            case Claim():
                fresh = self._proofs.fresh()
                return LeaseRequest(request.do, request.source, self._proofs.wanted, fresh_token=fresh)
            case Renew():
                return LeaseRequest("renew", token=request.lease)
            case Release():
                return LeaseRequest("release", token=request.lease, to=request.to)

    def _granted(self, answer: RequestAnswer) -> dict[str, object]:
        lease, ttl_ms = self._conductor.supervisor.lease, self._conductor.settings.lease.ttl_ms
        verified = None if lease.holder is None else lease.verified
        return {"lease": answer.token, "holder": lease.holder, "ttl_ms": ttl_ms, "verified": verified}


class ButtonAnswers(_ProvedAnswers):
    key = keys.BUTTON
    ack = ButtonAck
    schema = BUTTON_REQUEST
    denied = Reason.BUTTON_DENIED

    def _event(self, request: Register | Alive | Leave, now_ns: int) -> ButtonRequest:
        match request:
            case Alive():
                return ButtonRequest(
                    "alive", now_ns, token=request.button, count=request.count, sent_ms=request.sent_ms
                )
            case Leave():
                return ButtonRequest("leave", now_ns, token=request.button)
        # It counts if `buttons.names` has its person (`anna` of `anna/phone`) or its certificate's role.
        holder, names = self._proofs.holder(request.proof), self._conductor.settings.buttons.names
        named = {request.source.partition("/")[0]} if holder is None else {holder.name, holder.role}
        return ButtonRequest(
            "register",
            now_ns,
            request.source,
            None if holder is None else f"{holder.common_name} {holder.name}",
            not names or not named.isdisjoint(names),
            sent_ms=request.sent_ms,
            fresh_token=self._proofs.fresh(),
        )

    def _granted(self, answer: RequestAnswer) -> dict[str, object]:
        settings = self._conductor.settings.buttons
        return {
            "detail": answer.detail or None,
            "button": answer.token,
            "timeout_ms": settings.timeout_ms,
            "alive": self._conductor.supervisor.buttons.alive,
            "required": settings.required,
        }
