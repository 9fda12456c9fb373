"""The robot's signed list of revoked certificates, and the common names that Zenoh's access rules list without them.

Zenoh reads its rules when a session opens, so a newer list takes effect at the next start.
"""

import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import zenoh

from gateway import certs, durable
from gateway.certs import LAPTOP_ROLES, access
from gateway.errors import ConfigError
from gateway.host.directories import state_directory, state_to_read
from gateway.robot.settings import Settings
from gateway.zenoh_config import get

if TYPE_CHECKING:
    from cryptography import x509

    from gateway.certs.revocation import RevocationList

_CA: Final = "transport/link/tls/root_ca_certificate"
_SUBJECTS: Final = "access_control/subjects"

logger = logging.getLogger(__name__)


class RevocationState(NamedTuple):
    """The CAs that may sign a list, and the list in force."""

    cas: "tuple[x509.Certificate, ...]"
    path: Path
    known: "RevocationList | None"


def revocation_state(
    config: zenoh.Config, settings: Settings, *, started_by_systemd: bool = True
) -> RevocationState | None:
    """Return the CAs and the list in force, or None if the Zenoh file names no CA.

    Lists are searched in the state directory and in the Zenoh file's folder, to which one is copied with certificates.
    Without `started_by_systemd`, the service's folder is searched, too. Raises ConfigError if a list cannot be read.
    """
    ca = get(config, _CA)
    if not isinstance(ca, str) or not settings.zenoh.config:
        return None
    cas = tuple(certs.files.read_certificates(Path(ca)))
    beside = Path(settings.zenoh.config).absolute().parent
    find = state_directory if started_by_systemd else state_to_read
    state = find(settings.state.path)
    folders = [beside] if state is None else [state, beside]
    lists = [each for folder in folders if (each := _read(folder / certs.revocation.REVOCATION_FILE, cas)) is not None]
    newest = max(lists, key=lambda each: each.number, default=None)
    return RevocationState(cas, folders[0] / certs.revocation.REVOCATION_FILE, newest)


def list_common_names(config: zenoh.Config, known: "RevocationList | None") -> None:
    """Replace each role in the rules by its laptops' common names, without the revoked ones."""
    subjects = get(config, _SUBJECTS)
    shut_out = frozenset() if known is None else known.common_names
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


def _read(path: Path, cas: "tuple[x509.Certificate, ...]") -> "RevocationList | None":
    try:
        return certs.revocation.read(path, cas)
    except certs.revocation.ForeignListError as error:
        # The list's certificates are from a CA that this robot does not accept.
        logger.warning("%s; nobody is shut out by it", error)
        return None
