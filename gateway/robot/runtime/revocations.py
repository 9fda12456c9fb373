"""Takes a newer list of revoked certificates: writes it, then stops all legs and restarts the service to apply it."""

import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from pydantic import ValidationError

from gateway import certs
from gateway.errors import ConfigError
from gateway.robot.core.events import Announce
from gateway.robot.core.message import Reply
from gateway.robot.host.disk import DiskWriter
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import PAUSE_S, RequestAnswers
from gateway.robot.zenoh_io import revoked
from gateway.robot.zenoh_io.receiver import OwnersTask
from gateway.robot.zenoh_io.revoked import RevocationState
from schemas import keys
from schemas.revocation import MAX_REVOCATION_BYTES, RevocationAck, RevocationRequest
from schemas.telemetry import Kind, Reason, RevocationsReport

if TYPE_CHECKING:
    from gateway.certs.revocation import RevocationList

logger = logging.getLogger(__name__)


class Revocations(RequestAnswers):
    """Answers requests that bring a newer list. No decision depends on the clock."""

    key = keys.REVOCATION
    ack = RevocationAck
    most_bytes = MAX_REVOCATION_BYTES
    pause_s = PAUSE_S

    def __init__(self, conductor: Conductor, kept: RevocationState | None, begin_again: Callable[[], None]) -> None:
        """`kept` is None without a CA. `begin_again` is called on the loop and restarts the service."""
        super().__init__(conductor)
        self._kept = kept
        self._begin_again = begin_again
        self._disk = DiskWriter("keep list", conductor.loop, conductor.owner)
        self._keeps = False
        """Whether a list is being written; the service restarts afterwards."""
        known = None if kept is None else kept.known
        if known is not None:
            conductor.reports.revocations = RevocationsReport(number=known.number, date=known.date)

    def read(self, payload: bytes, _now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            text = RevocationRequest.model_validate_json(payload).revoked if payload else None
        except ValidationError:
            detail = 'the payload is not {"revoked": "a certificate revocation list as PEM"}'
            return partial(self.reject, source, Reason.INVALID, detail, reply)
        if text is None:
            return partial(self.answer, reply)
        if self._kept is None:
            detail = "this gateway's Zenoh file names no CA, so there are no certificates to revoke"
            return partial(self.reject, source, Reason.REVOCATION_DENIED, detail, reply)
        try:
            found = certs.revocation.parse(text.encode(), self._kept.cas)
        except ConfigError as error:
            return partial(self.reject, source, Reason.REVOCATION_DENIED, str(error), reply)
        return partial(self.change, found, reply)

    def answer(self, reply: Reply) -> None:
        """Answer with the list in force: its number (0: there is none) and its PEM text."""
        known = None if self._kept is None else self._kept.known
        if known is None:
            reply(self.accepted(number=0))
        else:
            reply(self.accepted(number=known.number, revoked=known.pem.decode()))

    def change(self, found: "RevocationList", reply: Reply) -> None:
        """Write the list if it is newer, then restart; reject an older one. The list in force is accepted again."""
        kept = self._kept
        known = None if kept is None else kept.known
        if known is not None and found.pem == known.pem:
            reply(self.accepted(number=known.number))
            return
        fault = (
            "another list is being saved; try again" if self._keeps else certs.revocation.why_not_newer(found, known)
        )
        if fault is not None or kept is None:
            self.reject(None, Reason.REVOCATION_DENIED, fault or "this gateway keeps no list", reply)
            return
        self._keeps = True
        # On a background thread, since a disk may take seconds.
        self._disk.write(partial(revoked.keep, kept.path, found), partial(self._put_in_force, kept, found, reply))

    def _put_in_force(self, kept: RevocationState, found: "RevocationList", reply: Reply, fault: str | None) -> None:
        self._keeps = False
        if fault is not None:
            self.reject(None, Reason.REVOCATION_DENIED, fault, reply)
            return
        known = frozenset() if kept.known is None else kept.known.common_names
        self._kept = kept._replace(known=found)  # so that no older list is accepted before the service ends
        names = ", ".join(sorted(found.common_names - known)) or "nobody else"
        detail = f"list {found.number} shuts out {names}: all legs stop, and the service starts anew"
        self._conductor.events.announce(Announce(Kind.REVOKED, detail, key=self.key))
        reply(self.accepted(number=found.number))
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            self._conductor.loop.call_soon_threadsafe(self._begin_again)
