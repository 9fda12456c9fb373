"""What is asked on the lease's key: read, and the proof checked, before anybody owns the robot's state for it.

To check a proof takes 0.3 ms. It is done on the thread that hears, so that no command and no Stop waits for it, and at
most `CHECKS_PER_S` times a second, since `cryptography` keeps the interpreter's lock meanwhile.
"""

import datetime as dt
import secrets
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import zenoh
from pydantic import ValidationError

from gateway import certs
from gateway.robot.core.events import Do, LeaseRequest
from gateway.robot.core.intake import Rejection
from gateway.robot.core.message import Reply
from gateway.robot.core.nonces import Nonces
from gateway.robot.edge.receiver import Deal
from gateway.robot.edge.request_reader import payload_of
from gateway.zenoh_config import get
from schemas.lease import LEASE_REQUEST, Challenge, Claim, LeaseAck, Release, Renew
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from gateway.certs import ProofChecker
    from gateway.certs.revocation import RevocationList

CHECKS_PER_S: Final = 20
"""6 ms a second of the interpreter's lock. A person asks once, and a program once for each lease."""


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
        self._checker = checker
        self._wall_clock = wall_clock
        self._fresh = fresh
        self._nonces = Nonces()
        self._checks = float(CHECKS_PER_S)
        self._checked_ns = 0

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
            return self._reject(None, *_why(error), reply)
        match request:
            case Challenge():
                nonce = None if self._checker is None else self._nonces.issue(self._fresh(), now_ns)
                return partial(reply, LeaseAck(accepted=True, nonce=nonce).model_dump_json().encode())
            case Claim():
                denied = self._why_denied(request, now_ns)
                if denied is not None:
                    return self._reject(request.source, Reason.LEASE_DENIED, denied, reply)
                verified = self._checker is not None
                asked = LeaseRequest(Do(request.do), request.source, verified, fresh_token=self._fresh())
            case Renew():
                asked = LeaseRequest(Do.RENEW, token=request.lease)
            case Release():
                asked = LeaseRequest(Do.RELEASE, token=request.lease, to=request.to)
        return partial(self._answers.ask, asked, reply)

    def _why_denied(self, claim: Claim, now_ns: int) -> str | None:
        if self._checker is None:
            return None
        if claim.proof is None:
            return f"proof is missing: this gateway wants to know that {claim.do} comes from source"
        if not self._nonces.spend(claim.proof.nonce, now_ns):
            return "proof.nonce is none of this gateway's, is older than 5 s, or has been used; get another (challenge)"
        self._checks = min(CHECKS_PER_S, self._checks + (now_ns - self._checked_ns) * CHECKS_PER_S / 1e9)
        self._checked_ns = now_ns
        if self._checks < 1:
            return "too many proofs have come within a second; try again"
        self._checks -= 1
        return self._checker.fault(claim.proof, claim.do, claim.source, self._wall_clock())

    def _reject(self, source: str | None, reason: Reason, detail: str, reply: Reply) -> Deal:
        return partial(self._answers.reject, source, reason, detail, reply)


def _why(error: ValidationError) -> tuple[Reason, str]:
    """Why it cannot be read. Nothing of what was sent is repeated: it may be a secret."""
    first = error.errors(include_url=False, include_input=False)[0]
    if first["type"] == "json_invalid":
        return Reason.MALFORMED, "the payload is not JSON"
    # The names in it are ours, but for one that is not known; the first is the verb's, which pydantic adds.
    known = [str(part) for part in first["loc"][1:]]
    if first["type"].startswith("union_tag") or not known:
        return Reason.INVALID, 'do must be "challenge", "acquire", "ask", "take", "renew" or "release"'
    if first["type"] == "extra_forbidden":
        return Reason.INVALID, "the payload has a field that is not known here"
    return Reason.INVALID, f"{'.'.join(known)} is missing, or not what docs/interface.md says"


def checker_of(config: zenoh.Config, revoked: "RevocationList | None" = None) -> "ProofChecker | None":
    """Checks proofs against the CA that the Zenoh file names; None where it names none. Raises ConfigError."""
    ca = _path(config, "root_ca_certificate")
    if ca is None:
        return None
    return certs.ProofChecker.of(
        ca, _path(config, "connect_certificate") or _path(config, "listen_certificate"), revoked
    )


def _path(config: zenoh.Config, name: str) -> Path | None:
    value: Any = get(config, f"transport/link/tls/{name}")
    return Path(value) if isinstance(value, str) else None
