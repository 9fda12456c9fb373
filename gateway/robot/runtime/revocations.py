"""The robot's signed list of revoked certificates: reads it at the start, and takes a newer one from a request.

Zenoh's access rules then list the common names without the revoked ones. Zenoh reads its rules when a session opens. So
a newer list is written, then all legs stop and the service restarts to apply it.
"""

import json
import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import zenoh
from pydantic import ValidationError

from gateway import certs
from gateway.certs import LAPTOP_ROLES, access
from gateway.errors import ConfigError
from gateway.files import durable
from gateway.host.directories import state_directory
from gateway.robot.core.events import NOBODY, Announce
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import Rejection
from gateway.robot.host.disk import DiskWriter
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import PAUSE_S, RequestAnswers
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io.receiver import OwnersTask
from gateway.zenoh.config import CA, get
from schemas import keys
from schemas.config import RevocationsReport
from schemas.revocation import MAX_REVOCATION_BYTES, RevocationAck, RevocationRequest
from schemas.words import Kind, Reason

if TYPE_CHECKING:
    from cryptography import x509

    from gateway.certs.revocation import RevocationList

_SUBJECTS: Final = "access_control/subjects"

logger = logging.getLogger(__name__)


class RevocationState(NamedTuple):
    """The CAs that may sign a list (none: no list is accepted), its file, and the list in force."""

    cas: "tuple[x509.Certificate, ...]" = ()
    path: Path = Path()
    known: "RevocationList | None" = None

    @property
    def common_names(self) -> frozenset[str]:
        """The common names that no rule may list."""
        return frozenset() if self.known is None else self.known.common_names


def revocation_state(config: zenoh.Config, settings: Settings) -> RevocationState:
    """Return the CAs that the Zenoh file names, and the list in force.

    Lists are searched in the state directory and in the Zenoh file's folder, to which one is copied with certificates.
    Raises ConfigError if a list cannot be read.
    """
    ca = get(config, CA)
    if not isinstance(ca, str) or not settings.zenoh.config:
        return RevocationState()
    cas = tuple(certs.files.read_certificates(Path(ca)))
    folders = (state_directory(settings.state.path), Path(settings.zenoh.config).absolute().parent)
    paths = [folder / certs.revocation.REVOCATION_FILE for folder in folders if folder is not None]
    found: list[RevocationList] = []
    for path in paths:
        try:
            found += filter(None, [certs.revocation.read(path, cas)])
        except certs.revocation.ForeignListError as error:
            # The list's certificates are from a CA that this robot does not accept.
            logger.warning("%s; nobody is shut out by it", error)
    return RevocationState(cas, paths[0], max(found, key=lambda each: each.number, default=None))


def list_common_names(config: zenoh.Config, shut_out: frozenset[str]) -> None:
    """Replace each role in the rules by its laptops' common names, without those that are shut out."""
    subjects = get(config, _SUBJECTS)
    for subject in subjects or ():
        named = subject.get("cert_common_names")
        if named:
            listed = [name for each in named for name in (access.every(each) if each in LAPTOP_ROLES else [each])]
            subject["cert_common_names"] = [name for name in listed if name not in shut_out] or [access.NOBODY]
    if subjects:
        config.insert_json5(_SUBJECTS, json.dumps(subjects))


def keep(path: Path, found: "RevocationList") -> None:
    """Write the list atomically; it is on the disk when this returns. A file written by root gets the folder's owner.

    Raises ConfigError if it cannot be written; the old list stays.
    """
    try:
        durable.write_like_the_folder(path, found.pem, 0o644)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); the earlier list stays in force") from error


class Revocations(RequestAnswers):
    """Answers requests that bring a newer list. No decision depends on the clock."""

    key = keys.REVOCATION
    ack = RevocationAck
    most_bytes = MAX_REVOCATION_BYTES
    pause_s = PAUSE_S

    def __init__(self, conductor: Conductor, kept: RevocationState, begin_again: Callable[[], None]) -> None:
        """`begin_again` is called on the loop and restarts the service."""
        super().__init__(conductor)
        self._kept = kept
        self._begin_again = begin_again
        self._disk = DiskWriter("keep list", conductor.loop, conductor.owner)
        self._writes = False
        if kept.known is not None:
            report = RevocationsReport(number=kept.known.number, date=kept.known.date)
            conductor.reports.revocations = report

    def read(self, payload: bytes, _now_ns: int, reply: Reply, source: str | None = None, /) -> OwnersTask:
        try:
            text = RevocationRequest.model_validate_json(payload).revoked if payload else None
            if text is None:
                return partial(self.answer, reply)
            return partial(self.change, certs.revocation.parse(text.encode(), self._kept.cas), reply)
        except ValidationError:
            why = Rejection(Reason.INVALID, 'the payload is not {"revoked": "a certificate revocation list as PEM"}')
        except ConfigError as error:
            why = Rejection(Reason.REVOCATION_DENIED, str(error))
        return partial(self.reject, (source, source), why, reply)

    def answer(self, reply: Reply) -> None:
        """Answer with the list in force: its number (0: there is none) and its PEM text."""
        known = self._kept.known
        found = {"number": 0} if known is None else {"number": known.number, "revoked": known.pem.decode()}
        reply(self.accepted(**found))

    def change(self, found: "RevocationList", reply: Reply) -> None:
        """Write the list if it is newer, then restart; reject an older one. The list in force is accepted again."""
        known = self._kept.known
        if known is not None and found.pem == known.pem:
            reply(self.accepted(number=known.number))
            return
        fault = certs.revocation.why_not_newer(found, known)
        if self._writes:
            fault = "another list is being saved; try again"
        if fault is not None:
            self.reject(NOBODY, Rejection(Reason.REVOCATION_DENIED, fault), reply)
            return
        self._writes = True
        # On a background thread, since a disk may take seconds.
        self._disk.write(partial(keep, self._kept.path, found), partial(self._put_in_force, found, reply))

    def _put_in_force(self, found: "RevocationList", reply: Reply, fault: str | None) -> None:
        self._writes = False
        if fault is not None:
            self.reject(NOBODY, Rejection(Reason.REVOCATION_DENIED, fault), reply)
            return
        names = ", ".join(sorted(found.common_names - self._kept.common_names)) or "nobody else"
        self._kept = self._kept._replace(known=found)  # so that no older list is accepted before the service ends
        detail = f"list {found.number} shuts out {names}: all legs stop, and the service starts anew"
        self._conductor.reports.announce(Announce(Kind.REVOKED, detail, key=self.key))
        reply(self.accepted(number=found.number))
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            self._conductor.loop.call_soon_threadsafe(self._begin_again)
