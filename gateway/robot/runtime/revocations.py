"""The list of who is shut out: kept, and then put in force by a service that starts anew, legs stopped first."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from gateway import certs
from gateway.errors import ConfigError
from gateway.robot.core.message import Reply
from gateway.robot.edge import revoked
from gateway.robot.edge.revoked import Kept
from gateway.robot.runtime.conductor import Conductor
from schemas import keys
from schemas.revocation import RevocationAck
from schemas.telemetry import Kind, Reason

if TYPE_CHECKING:
    from gateway.certs.revocation import RevocationList


class Revocations:
    """Everything here is called by the owner of the robot's state, but for the thread that writes."""

    def __init__(
        self,
        conductor: Conductor,
        kept: Kept | None,
        loop: asyncio.AbstractEventLoop,
        begin_again: Callable[[], None],
    ) -> None:
        """`begin_again` ends the service, so that it starts anew; it is called on the loop."""
        self._conductor = conductor
        self._kept = kept
        self._loop = loop
        self._begin_again = begin_again
        self._keeps = False
        """A list is being written; the service starts anew once it is."""

    def answer(self, reply: Reply) -> None:
        """Say which list is in force."""
        known = None if self._kept is None else self._kept.known
        ack = (
            RevocationAck(accepted=True, number=0)
            if known is None
            else RevocationAck(accepted=True, number=known.number, revoked=known.pem.decode())
        )
        reply(ack.model_dump_json().encode())

    def change(self, found: "RevocationList", reply: Reply) -> None:
        """Keep this list, if it is newer, and start anew with it. The one that is in force is accepted again."""
        known = None if self._kept is None else self._kept.known
        if known is not None and found.pem == known.pem:
            reply(RevocationAck(accepted=True, number=known.number).model_dump_json().encode())
            return
        fault = "another list is being kept; try again" if self._keeps else certs.revocation.why_not_newer(found, known)
        if fault is not None or self._kept is None:
            self.reject(Reason.REVOCATION_DENIED, fault or "this gateway keeps no list", reply)
            return
        self._keeps = True
        # A disk may take seconds, and no Stop waits for one.
        threading.Thread(target=self._write, args=(self._kept, found, reply), name="keep list", daemon=True).start()

    def reject(self, reason: Reason, detail: str, reply: Reply) -> None:
        """Answer what changes nothing, and tell of it."""
        reply(RevocationAck(accepted=False, reason=reason, detail=detail).model_dump_json().encode())
        self._conductor.answers.reject_unread(keys.REVOCATION, None, detail, reason)

    def _write(self, kept: Kept, found: "RevocationList", reply: Reply) -> None:
        try:
            revoked.keep(kept.path, found)
        except ConfigError as error:
            done = partial(self.reject, Reason.REVOCATION_DENIED, str(error), reply)
        else:
            done = partial(self._put_in_force, kept, found, reply)
        with self._conductor.owner:
            self._keeps = False
            done()

    def _put_in_force(self, kept: Kept, found: "RevocationList", reply: Reply) -> None:
        known = frozenset() if kept.known is None else kept.known.common_names
        self._kept = kept._replace(known=found)  # or an older list could still take its place before the service ends
        names = ", ".join(sorted(found.common_names - known)) or "nobody else"
        detail = f"list {found.number} shuts out {names}: all legs stop, and the service starts anew"
        self._conductor.announce(Kind.REVOKED, detail, keys.REVOCATION)
        reply(RevocationAck(accepted=True, number=found.number).model_dump_json().encode())
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            self._loop.call_soon_threadsafe(self._begin_again)
