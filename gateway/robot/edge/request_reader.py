"""What is asked on the keys that take `get` only: read, and its proof checked, before anybody owns the robot's state.

A reader is one key's. It reads questions one by one, on one thread, and returns what an owner of the state is to do.
"""

import datetime as dt
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, Protocol, TypeVar

import zenoh
from pydantic import ValidationError

from gateway import certs
from gateway.errors import ConfigError
from gateway.robot.core import calibration_intake
from gateway.robot.core.calibration_intake import CalibrationIntent
from gateway.robot.core.events import ButtonDo, ButtonRequest, Do, LeaseRequest
from gateway.robot.core.intake import ENCODINGS, Rejection, too_large
from gateway.robot.core.message import Reply
from gateway.robot.edge.proofs import Proofs, fresh_token
from gateway.robot.edge.receiver import Deal
from gateway.robot.edge.revoked import Kept
from schemas.button import BUTTON_REQUEST, Alive, ButtonAck, Leave, Register
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.lease import LEASE_REQUEST, Challenge, Claim, LeaseAck, Release, Renew
from schemas.revocation import MAX_REVOCATION_BYTES, RevocationRequest
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from gateway.certs import ProofChecker
    from gateway.certs.revocation import RevocationList

R_contra = TypeVar("R_contra", contravariant=True)
R = TypeVar("R", ButtonRequest, LeaseRequest)

Reader = Callable[[zenoh.Query, int, Reply], Deal]
"""Reads one question, which came at this time (ns), on a thread that owns nothing."""

PAUSE_S: Final = 0.05
"""Between two that change a file: twenty a second, each of which may take a millisecond. A person writes one."""
BY_WILDCARD: Final = Rejection(Reason.INVALID, "this key is not asked by wildcard: name it")
BAD_ENCODING: Final = Rejection(Reason.BAD_ENCODING, "the encoding must be application/json, or left out")

_LEASE_DOES: Final = '"challenge", "acquire", "ask", "take", "renew" or "release"'
_BUTTON_DOES: Final = '"challenge", "register", "alive" or "leave"'


def why_unread(error: ValidationError, does: str) -> tuple[Reason, str]:
    """Why a request cannot be read, which may `do` these. Nothing of what was sent is repeated: it may be a secret."""
    first = error.errors(include_url=False, include_input=False)[0]
    if first["type"] == "json_invalid":
        return Reason.MALFORMED, "the payload is not JSON"
    # The names in it are ours, but for one that is not known; the first is the verb's, which pydantic adds.
    known = [str(part) for part in first["loc"][1:]]
    if first["type"].startswith("union_tag") or not known:
        return Reason.INVALID, f"do must be {does}"
    if first["type"] == "extra_forbidden":
        return Reason.INVALID, "the payload has a field that is not known here"
    return Reason.INVALID, f"{'.'.join(known)} is missing, or not what docs/interface.md says"


def payload_of(query: zenoh.Query, most: int = MAX_PAYLOAD_BYTES) -> bytes | Rejection:
    """The payload, of `most` bytes at most, or why it is not read."""
    payload = query.payload
    if "*" in str(query.key_expr):  # whoever lists what there is wants to see, and asks for nothing
        return BY_WILDCARD
    if payload is not None and len(payload) > most:
        return too_large(len(payload), most)
    if query.encoding is not None and str(query.encoding) not in ENCODINGS:
        return BAD_ENCODING
    return b"" if payload is None else payload.to_bytes()


def _paced(deal: Deal) -> Deal:
    """The same, with a pause after it."""

    def paced() -> float:
        deal()
        return PAUSE_S

    return paced


# ---- lease and buttons: who asks is proved


class Answers(Protocol[R_contra]):
    """Who decides; to be called by an owner of the state."""

    def ask(self, request: R_contra, reply: Reply) -> None:
        """Decide, and answer."""

    def reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer what is rejected already, and tell of it."""


class _ProvedReader(ABC, Generic[R]):
    def __init__(self, answers: Answers[R], proofs: Proofs) -> None:
        self._answers: Answers[R] = answers
        self._proofs = proofs

    def note(self, query: zenoh.Query, now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it."""
        payload = payload_of(query)
        if isinstance(payload, Rejection):
            return self._reject(None, payload.reason, payload.detail, reply)
        return self.read(payload, now_ns, reply)

    @abstractmethod
    def read(self, payload: bytes, now_ns: int, reply: Reply) -> Deal:
        """Read one payload, which came at this time; what is then to be done with it."""

    def _reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> Deal:
        return partial(self._answers.reject, source, reason, detail, reply)


class LeaseRequestReader(_ProvedReader[LeaseRequest]):
    """Of the lease's key."""

    def __init__(
        self,
        answers: Answers[LeaseRequest],
        checker: "ProofChecker | None",
        *,
        wall_clock: Callable[[], dt.datetime],
        fresh: Callable[[], str] = fresh_token,
    ) -> None:
        """Without a `checker` names are taken as they are."""
        super().__init__(answers, Proofs(checker, wall_clock, fresh))

    def read(self, payload: bytes, now_ns: int, reply: Reply) -> Deal:
        try:
            request = LEASE_REQUEST.validate_json(payload)
        except ValidationError as error:
            return self._reject(None, *why_unread(error, _LEASE_DOES), reply)
        match request:
            case Challenge():
                nonce = self._proofs.challenge(now_ns)
                return partial(reply, LeaseAck(accepted=True, nonce=nonce).model_dump_json().encode())
            case Claim():
                denied = self._proofs.why_denied(request.proof, request.do, request.source, now_ns)
                if denied is not None:
                    return self._reject(request.source, Reason.LEASE_DENIED, denied, reply)
                fresh = self._proofs.fresh()
                asked = LeaseRequest(Do(request.do), request.source, self._proofs.wanted, fresh_token=fresh)
            case Renew():
                asked = LeaseRequest(Do.RENEW, token=request.lease)
            case Release():
                asked = LeaseRequest(Do.RELEASE, token=request.lease, to=request.to)
        return partial(self._answers.ask, asked, reply)


class ButtonRequestReader(_ProvedReader[ButtonRequest]):
    """Of the buttons' key."""

    def __init__(
        self,
        answers: Answers[ButtonRequest],
        checker: "ProofChecker | None",
        *,
        wall_clock: Callable[[], dt.datetime],
        fresh: Callable[[], str] = fresh_token,
    ) -> None:
        """Without a `checker` names are taken as they are."""
        # `cryptography` is loaded for a gateway with certificates only.
        purpose = None if checker is None else certs.proof.WATCHING
        super().__init__(answers, Proofs(checker, wall_clock, fresh, purpose))

    def read(self, payload: bytes, now_ns: int, reply: Reply) -> Deal:
        try:
            request = BUTTON_REQUEST.validate_json(payload)
        except ValidationError as error:
            return self._reject(None, *why_unread(error, _BUTTON_DOES), reply)
        match request:
            case Challenge():
                ack = ButtonAck(accepted=True, nonce=self._proofs.challenge(now_ns))
                return partial(reply, ack.model_dump_json().encode())
            case Register():
                denied = self._proofs.why_denied(request.proof, request.do, request.source, now_ns)
                if denied is not None:
                    return self._reject(request.source, Reason.BUTTON_DENIED, denied, reply)
                asked = ButtonRequest(
                    ButtonDo.REGISTER,
                    now_ns,
                    request.source,
                    sent_ms=request.sent_ms,
                    fresh_token=self._proofs.fresh(),
                )
            case Alive():
                asked = ButtonRequest(
                    ButtonDo.ALIVE, now_ns, token=request.button, count=request.count, sent_ms=request.sent_ms
                )
            case Leave():
                asked = ButtonRequest(ButtonDo.LEAVE, now_ns, token=request.button)
        return partial(self._answers.ask, asked, reply)


# ---- calibration


class Calibrations(Protocol):
    """Who decides; to be called by an owner of the state."""

    def change(self, intent: CalibrationIntent, source: str | None, reply: Reply) -> None:
        """Decide, and answer once that is kept."""

    def reject(self, source: str | None, rejection: Rejection, reply: Reply) -> None:
        """Answer what is rejected already, and tell of it."""


class CalibrationRequestReader:
    """Of the calibration's key."""

    def __init__(self, calibrations: Calibrations) -> None:
        self._calibrations = calibrations

    def note(self, query: zenoh.Query, _now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it, with a pause after it."""
        source = str(query.source_info.source_id.zid) if query.source_info is not None else None
        payload = payload_of(query)
        if isinstance(payload, Rejection):
            return _paced(partial(self._calibrations.reject, source, payload, reply))
        return _paced(self.read(payload, reply, source))

    def read(self, payload: bytes, reply: Reply, source: str | None = None) -> Deal:
        """Read one payload; what is then to be done with it."""
        intent = calibration_intake.read(payload)
        if isinstance(intent, Rejection):
            return partial(self._calibrations.reject, source, intent, reply)
        return partial(self._calibrations.change, intent, intent.source or source, reply)


# ---- revocations


class Revocations(Protocol):
    """Who keeps the list; to be called by an owner of the state."""

    def answer(self, reply: Reply) -> None:
        """Say which list is in force."""

    def change(self, found: "RevocationList", reply: Reply) -> None:
        """Keep this newer list, answer, and start anew with it."""

    def reject(self, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer what changes nothing, and tell of it."""


class RevocationRequestReader:
    """Of the revocations' key. Nothing here is judged by the clock."""

    def __init__(self, revocations: Revocations, kept: Kept | None) -> None:
        """`kept`: None where there is no CA, and so nobody to shut out."""
        self._revocations = revocations
        self._kept = kept

    def note(self, query: zenoh.Query, _now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it, with a pause after it."""
        payload = payload_of(query, MAX_REVOCATION_BYTES)
        if isinstance(payload, Rejection):
            return _paced(partial(self._revocations.reject, payload.reason, payload.detail, reply))
        return _paced(self.read(payload, reply))

    def read(self, payload: bytes, reply: Reply) -> Deal:
        """Read one payload; what is then to be done with it."""
        if not payload:
            return partial(self._revocations.answer, reply)
        try:
            request = RevocationRequest.model_validate_json(payload)
        except ValidationError:
            detail = 'the payload is not {"revoked": "a certificate revocation list as PEM"}'
            return partial(self._revocations.reject, Reason.INVALID, detail, reply)
        if request.revoked is None:
            return partial(self._revocations.answer, reply)
        if self._kept is None:
            detail = "this gateway's Zenoh file names no CA, so it knows nobody by a certificate"
            return partial(self._revocations.reject, Reason.REVOCATION_DENIED, detail, reply)
        try:
            found = certs.revocation.parse(request.revoked.encode(), self._kept.cas)
        except ConfigError as error:
            return partial(self._revocations.reject, Reason.REVOCATION_DENIED, str(error), reply)
        return partial(self._revocations.change, found, reply)
