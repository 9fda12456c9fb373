"""What is asked on the lease's key: read, and the proof checked, before anybody owns the robot's state for it."""

import datetime as dt
import secrets
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

import zenoh
from pydantic import ValidationError

from gateway.robot.core.events import Do, LeaseRequest
from gateway.robot.core.intake import Rejection
from gateway.robot.core.message import Reply
from gateway.robot.edge.proofs import Proofs
from gateway.robot.edge.receiver import Deal
from gateway.robot.edge.request_reader import payload_of, why_unread
from schemas.lease import LEASE_REQUEST, Challenge, Claim, LeaseAck, Release, Renew
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from gateway.certs import ProofChecker


_DOES: Final = '"challenge", "acquire", "ask", "take", "renew" or "release"'


class Answers(Protocol):
    """Who decides; to be called by an owner of the state."""

    def ask(self, request: LeaseRequest, reply: Reply) -> None:
        """Decide, and answer."""

    def reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer what is rejected already, and tell of it."""


class LeaseRequestReader:
    """Reads requests one by one, on one thread."""

    def __init__(
        self,
        answers: Answers,
        checker: "ProofChecker | None",
        *,
        wall_clock: Callable[[], dt.datetime],
        fresh: Callable[[], str] = lambda: secrets.token_hex(16),
    ) -> None:
        """Without a `checker` names are taken as they are."""
        self._answers = answers
        self._proofs = Proofs(checker, wall_clock, fresh)

    def note(self, query: zenoh.Query, now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it."""
        payload = payload_of(query)
        if isinstance(payload, Rejection):
            return self._reject(None, payload.reason, payload.detail, reply)
        return self.read(payload, now_ns, reply)

    def read(self, payload: bytes, now_ns: int, reply: Reply) -> Deal:
        """Read one payload; what is then to be done with it."""
        try:
            request = LEASE_REQUEST.validate_json(payload)
        except ValidationError as error:
            return self._reject(None, *why_unread(error, _DOES), reply)
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

    def _reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> Deal:
        return partial(self._answers.reject, source, reason, detail, reply)
