"""The signed list of revoked certificates that the robot keeps, and the Zenoh rules without them.

Zenoh reads its rules when a session opens, so a newer list takes effect at the next start.
"""

import json
import logging
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import zenoh

from gateway import certs, durable
from gateway.certs import pool
from gateway.errors import ConfigError
from gateway.host.directories import SERVICE_RUNTIME, runtime_directory, state_directory, state_to_read
from gateway.robot.sections import ZenohSettings
from gateway.zenoh_config import get

if TYPE_CHECKING:
    from cryptography import x509

    from gateway.certs.revocation import RevocationList

_CA: Final = "transport/link/tls/root_ca_certificate"
_SUBJECTS: Final = "access_control/subjects"

OLDER_CA: Final = "older-ca"
"""File in the service's runtime directory: the common names seen since the start, one a line."""

logger = logging.getLogger(__name__)


class RevocationState(NamedTuple):
    """The CAs that may sign a list, and the list in force."""

    cas: "tuple[x509.Certificate, ...]"
    path: Path
    known: "RevocationList | None"
    """The list in force; None: there is none."""
    stale: int | None = None
    """Number of an older list found at `path` (0: none was there), although this robot has seen the one in force."""

    @property
    def first_number(self) -> int | None:
        """The first number of the newer CA's common names; None unless there are two CAs."""
        return max(map(certs.authority.first_number, self.cas)) if len(self.cas) > 1 else None


def revocation_state(
    config: zenoh.Config, settings: ZenohSettings, *, started_by_systemd: bool = True
) -> RevocationState | None:
    """What is in force; None if the Zenoh file names no CA. Raises ConfigError for a list that cannot be read.

    Without `started_by_systemd`, the service's folder is searched as well. A list in the Zenoh file's folder counts
    too: it is copied along with a folder of certificates.
    """
    ca = get(config, _CA)
    if not isinstance(ca, str) or not settings.config:
        return None
    cas = tuple(certs.files.read_certificates(Path(ca)))
    beside = Path(settings.config).absolute().parent
    state = state_directory() if started_by_systemd else state_to_read()
    folders = [beside] if state is None else [state, beside]
    lists = [each for folder in folders if (each := _read(folder / certs.revocation.REVOCATION_FILE, cas)) is not None]
    found = max(lists, key=lambda each: each.number, default=None)
    number = 0 if found is None else found.number
    seen = _seen(folders[0], number, cas)
    return RevocationState(
        cas, folders[0] / certs.revocation.REVOCATION_FILE, seen or found, None if seen is None else number
    )


def leave_out(config: zenoh.Config, known: "RevocationList | None") -> None:
    """Remove revoked common names from the rules. Zenoh takes a subject without names as everyone."""
    subjects = get(config, _SUBJECTS)
    if known is None or not subjects:
        return
    for subject in subjects:
        names = subject.get("cert_common_names")
        if names:
            subject["cert_common_names"] = [name for name in names if name not in known.common_names] or [
                pool.NO_COMMON_NAME
            ]
    config.insert_json5(_SUBJECTS, json.dumps(subjects))


def keep(path: Path, found: "RevocationList") -> None:
    """Write the list atomically; it is on the disk when this returns. Raises ConfigError, and the old one stays.

    A second copy has the list's number in its name. An older backup unpacked over this folder does not contain that
    file, so the robot still finds the newest list that it has seen. Written by root, both belong to the folder's owner.
    """
    numbered = path.with_name(f"{path.stem}-{found.number}{path.suffix}")
    try:
        for each in (numbered, path):
            if not each.exists() or each.read_bytes() != found.pem:
                durable.write_with_mode(each, found.pem, 0o644, prepare=partial(durable.like_the_folder, each))
        for number, each in _numbered(path.parent).items():
            if number < found.number:
                each.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); the list before stays in force") from error


def _seen(folder: Path, above: int, cas: "Sequence[x509.Certificate]") -> "RevocationList | None":
    """The newest numbered copy with a number greater than `above`."""
    newer = sorted(((number, path) for number, path in _numbered(folder).items() if number > above), reverse=True)
    lists = (_read(path, cas) for _, path in newer)
    return next((each for each in lists if each is not None and each.number > above), None)


def _numbered(folder: Path) -> dict[int, Path]:
    name = Path(certs.revocation.REVOCATION_FILE)
    paths = {path.stem.removeprefix(f"{name.stem}-"): path for path in folder.glob(f"{name.stem}-*{name.suffix}")}
    return {int(number): path for number, path in paths.items() if number.isdecimal()}


def _read(path: Path, cas: "Sequence[x509.Certificate]") -> "RevocationList | None":
    try:
        return certs.revocation.read(path, cas)
    except certs.revocation.ForeignListError as error:
        # The certificates on it are of a CA that this robot does not accept anyway.
        logger.warning("%s; nobody is shut out by it", error)
        return None


class OlderCa:
    """Records which clients still use a certificate of the older of two CAs, for the metrics and `check`.

    Each CA has its own range of common names, so the name alone shows it. Not thread-safe.
    """

    def __init__(self, shut_out: RevocationState | None, count: Callable[[int], None]) -> None:
        """`count` gets their number since the start."""
        self._first = None if shut_out is None else shut_out.first_number
        self._count = count
        self._names: set[str] = set()
        folder = runtime_directory()
        self._path = None if folder is None else folder / OLDER_CA
        self._write()

    def note(self, common_names: Collection[str]) -> None:
        """Record the common names that are connected now."""
        first = self._first
        if first is None:
            return
        found = {name for name in common_names if pool.is_before(name, first)}
        if not found <= self._names:
            self._names |= found
            self._count(len(self._names))
            self._write()

    def _write(self) -> None:
        if self._path is None:
            return
        try:
            self._path.write_text("".join(f"{name}\n" for name in sorted(self._names)))
        except OSError as error:
            logger.warning("`check` cannot see who still has a certificate of the older CA: %s", error)


def of_older_ca() -> list[str]:
    """The common names that the running service has recorded. Raises OSError."""
    return ((runtime_directory() or SERVICE_RUNTIME) / OLDER_CA).read_text().split()
