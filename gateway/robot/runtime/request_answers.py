"""Requests on the keys that take `get` only. Each key has a `RequestAnswers` and a receiver thread.

The receiver thread parses one request after another and checks its proof, without owning the robot's state: a check
takes 0.3 ms, and no command and no Stop waits for it. Then an owner of the state decides and answers.
"""

import datetime as dt
import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

import zenoh
from pydantic import BaseModel, TypeAdapter, ValidationError

from gateway import certs
from gateway.certs.proof import Nonces
from gateway.rate_limit import RateLimit
from gateway.robot.core.events import ButtonRequest, LeaseRequest, RequestAnswer, Sender
from gateway.robot.core.intake import is_json
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import BAD_ENCODING, Rejection, explain, too_large
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.report import wall_clock
from gateway.robot.zenoh_io.receiver import OwnersTask
from schemas import keys
from schemas.button import BUTTON_REQUEST, Alive, ButtonAck, Leave, Register
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.lease import LEASE_REQUEST, Challenge, Claim, LeaseAck, Release, Renew
from schemas.words import Reason

if TYPE_CHECKING:
    from gateway.certs.proof import ProofChecker

PAUSE_S: Final = 0.05
"""The pause between two requests that may write a file: 20 a second, each of which may take a millisecond."""
CHECKS_PER_S: Final = 20
"""Proofs. They hold the interpreter's lock for 6 ms a second. A person or program needs one check for each lease."""
NONCE_NS: Final = 5_000_000_000
"""docs/interface.md, Behaviour *Lease*. A laptop signs within milliseconds; a slow network adds a second."""
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
            task: OwnersTask = partial(self.reject, (source, source), unread, reply)
        else:
            task = self.read(b"" if payload is None else payload.to_bytes(), now_ns, reply, source)
        return task if self.pause_s is None else partial(_with_pause, task, self.pause_s)

    @abstractmethod
    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        """Parse a payload received at `now_ns`. Return the task. `source` is the Zenoh id of the sender."""

    def accepted(self, **fields: object) -> bytes:
        """Return an accepting answer with these fields, as JSON."""
        return self.ack(accepted=True, **fields).model_dump_json().encode()

    def reject(self, sender: Sender, why: Rejection, reply: Reply, **more: object) -> None:
        """Reject a request and publish the rejection. `more` are further fields of the answer."""
        self._conductor.executor.reject_unread(self.key, sender, why.detail, why.reason)
        reply(self.ack(accepted=False, reason=why.reason, detail=why.detail, **more).model_dump_json().encode())


def _with_pause(task: OwnersTask, pause_s: float) -> float:
    task()
    return pause_s


# ---- lease and buttons: the sender is proved


class _ProvedAnswers(RequestAnswers):
    """Answers requests whose sender may have to prove its name."""

    schema: ClassVar[TypeAdapter[Any]]
    denied: ClassVar[Reason]
    """Why a request without a valid proof is rejected."""
    watches: ClassVar[bool]
    """Whether its proofs are of buttons, not of drivers."""

    def __init__(
        self,
        conductor: Conductor,
        checker: "ProofChecker | None",
        wall_clock: Callable[[], dt.datetime] = wall_clock,
        fresh: Callable[[], str] = lambda: secrets.token_hex(16),
    ) -> None:
        """Without a `checker`, names are accepted unproved. `fresh` returns 128 random bits as hex."""
        super().__init__(conductor)
        self._checker = checker
        self._wall_clock = wall_clock
        self._fresh = fresh
        self._nonces = Nonces(NONCE_NS)
        self._checks = RateLimit(CHECKS_PER_S, CHECKS_PER_S)

    def read(self, payload: bytes, now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            request = self.schema.validate_json(payload)
        except ValidationError as error:
            return partial(self.reject, (source, source), explain(error), reply)
        if isinstance(request, Challenge):
            nonce = None if self._checker is None else self._nonces.issue(self._fresh(), now_ns)
            return partial(reply, self.accepted(nonce=nonce))
        if isinstance(request, Claim | Register) and self._checker is not None:
            denied = self._why_denied(self._checker, request, now_ns)
            if denied is not None:
                return partial(self.reject, (request.source, source), Rejection(self.denied, denied), reply)
        event = self._event(request, now_ns)
        event.source_id = source
        return partial(self.ask, event, reply)

    def _why_denied(self, checker: "ProofChecker", request: Claim | Register, now_ns: int) -> str | None:
        """Return why the proof does not show that `source` makes this request; None if it does."""
        proof = request.proof
        if proof is None:
            return f"proof is missing: this gateway needs a proof that {request.do} comes from source"
        if not self._nonces.spend(proof.nonce, now_ns):
            return "proof.nonce is none of this gateway's, is older than 5 s, or has been used; get another (challenge)"
        if not self._checks.take(now_ns):
            return "too many proofs have come within a second; try again"
        purpose = certs.proof.WATCHING if self.watches else certs.proof.DRIVING
        return checker.fault(proof, request.do, request.source, self._wall_clock(), purpose)

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
        why = Rejection(answer.reason, answer.detail)
        self.reject((request.source, request.source_id), why, reply, **more)


class LeaseAnswers(_ProvedAnswers):
    key = keys.LEASE
    ack = LeaseAck
    schema = LEASE_REQUEST
    denied = Reason.LEASE_DENIED
    watches = False

    def _event(self, request: Claim | Renew | Release, now_ns: int) -> LeaseRequest:  # noqa: ARG002
        if isinstance(request, Claim):
            return LeaseRequest(request.do, request.source, fresh_token=self._fresh())
        to = request.to if isinstance(request, Release) else None
        return LeaseRequest(request.do, token=request.lease, to=to)

    def _granted(self, answer: RequestAnswer) -> dict[str, object]:
        lease, ttl_ms = self._conductor.supervisor.lease, self._conductor.settings.lease.ttl_ms
        verified = None if lease.holder is None else self._checker is not None
        return {"lease": answer.token, "holder": lease.holder, "ttl_ms": ttl_ms, "verified": verified}


class ButtonAnswers(_ProvedAnswers):
    key = keys.BUTTON
    ack = ButtonAck
    schema = BUTTON_REQUEST
    denied = Reason.BUTTON_DENIED
    watches = True

    def _event(self, request: Register | Alive | Leave, now_ns: int) -> ButtonRequest:
        match request:
            case Alive():
                return ButtonRequest(
                    "alive", now_ns, token=request.button, count=request.count, sent_ms=request.sent_ms
                )
            case Leave():
                return ButtonRequest("leave", now_ns, token=request.button)
        # It counts if `buttons.names` has its person (`anna` of `anna/phone`) or its certificate's role.
        proof, names = request.proof, self._conductor.settings.buttons.names
        holder = None if self._checker is None or proof is None else certs.proof.holder(proof)
        named = {request.source.partition("/")[0]} if holder is None else {holder.name, holder.role}
        return ButtonRequest(
            "register",
            now_ns,
            request.source,
            None if holder is None else f"{holder.common_name} {holder.name}",
            not names or not named.isdisjoint(names),
            sent_ms=request.sent_ms,
            fresh_token=self._fresh(),
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
