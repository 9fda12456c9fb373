"""What is asked on the key of the revocations: read, and its signature checked, before anybody owns the state."""

from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

import zenoh
from pydantic import ValidationError

from gateway import certs
from gateway.errors import ConfigError
from gateway.robot.core.intake import Rejection
from gateway.robot.core.message import Reply
from gateway.robot.edge.receiver import Deal
from gateway.robot.edge.request_reader import payload_of
from gateway.robot.edge.revoked import Kept
from schemas.revocation import MAX_REVOCATION_BYTES, RevocationRequest
from schemas.telemetry import Reason

if TYPE_CHECKING:
    from gateway.certs.revocation import RevocationList

PAUSE_S: Final = 0.05
"""Between two: twenty a second, each of which may take a millisecond. A person sends one in years."""


class Revocations(Protocol):
    """Who keeps the list; to be called by an owner of the state."""

    def answer(self, reply: Reply) -> None:
        """Say which list is in force."""

    def change(self, found: "RevocationList", reply: Reply) -> None:
        """Keep this newer list, answer, and start anew with it."""

    def reject(self, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer what changes nothing, and tell of it."""


class RevocationRequestReader:
    """Reads requests one by one, on one thread. Nothing here is judged by the clock."""

    def __init__(self, revocations: Revocations, kept: Kept | None) -> None:
        """`kept`: None where there is no CA, and so nobody to shut out."""
        self._revocations = revocations
        self._kept = kept

    def note(self, query: zenoh.Query, _now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it, with a pause after it."""
        payload = payload_of(query, MAX_REVOCATION_BYTES)
        if isinstance(payload, Rejection):
            deal: Deal = partial(self._revocations.reject, payload.reason, payload.detail, reply)
        else:
            deal = self.read(payload, reply)

        def paced() -> float:
            deal()
            return PAUSE_S

        return paced

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
