"""Who is shut out: the signed list that the robot keeps, and a configuration that lists none of those any more.

Zenoh's access control is read when a session opens, so a newer list takes effect with the next start.
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
from gateway.robot.host.directories import SERVICE_RUNTIME, SERVICE_STATE, runtime_directory, state_directory
from gateway.robot.settings import ZenohSettings
from gateway.zenoh_config import get

if TYPE_CHECKING:
    from cryptography import x509

    from gateway.certs.revocation import RevocationList

_CA: Final = "transport/link/tls/root_ca_certificate"
_SUBJECTS: Final = "access_control/subjects"

OLDER_CA: Final = "older-ca"
"""In the service's runtime directory: the common names since the start, a line each."""

logger = logging.getLogger(__name__)


class Kept(NamedTuple):
    """What a robot needs to judge a list, and where it keeps the one in force."""

    cas: "tuple[x509.Certificate, ...]"
    path: Path
    known: "RevocationList | None"
    """The list in force."""
    stale: int | None = None
    """Number of the list in its place (0: none is there), where this robot has seen a newer one, which is in force."""

    @property
    def first_number(self) -> int | None:
        """Of two CAs, the first number of the newer one's common names; None while there is one."""
        return max(map(certs.authority.first_number, self.cas)) if len(self.cas) > 1 else None


def kept(config: zenoh.Config, settings: ZenohSettings, *, started_by_systemd: bool = True) -> Kept | None:
    """What is in force; None where the Zenoh file names no CA. Raises ConfigError for a list that cannot be read.

    `started_by_systemd`: this process is the service itself, or none is installed; else the service's folder is looked
    at. A list beside the Zenoh file counts as well: whoever copies a folder of certificates brings it along.
    """
    ca = get(config, _CA)
    if not isinstance(ca, str) or not settings.config:
        return None
    cas = tuple(certs.files.read_certificates(Path(ca)))
    beside = Path(settings.config).absolute().parent
    state = state_directory()
    if state is None and not started_by_systemd and SERVICE_STATE.is_dir():
        state = SERVICE_STATE
    folders = [beside] if state is None else [state, beside]
    lists = [each for folder in folders if (each := _read(folder / certs.revocation.FILE_NAME, cas)) is not None]
    found = max(lists, key=lambda each: each.number, default=None)
    number = 0 if found is None else found.number
    seen = _seen(folders[0], number, cas)
    return Kept(cas, folders[0] / certs.revocation.FILE_NAME, seen or found, None if seen is None else number)


def leave_out(config: zenoh.Config, known: "RevocationList | None") -> None:
    """Take those who are revoked out of the rules. A subject without names would be everybody to Zenoh."""
    subjects = get(config, _SUBJECTS)
    if known is None or not subjects:
        return
    for subject in subjects:
        names = subject.get("cert_common_names")
        if names:
            subject["cert_common_names"] = [name for name in names if name not in known.common_names] or [pool.NOBODY]
    config.insert_json5(_SUBJECTS, json.dumps(subjects))


def keep(path: Path, found: "RevocationList") -> None:
    """Write the list: it is on the disk when this returns, or the one before is. Raises ConfigError.

    It is written under its number, too. An older backup that is unpacked over this folder has no such file, so the
    robot still knows the newest list that it has seen. Written by root, it belongs to the folder's owner, which is the
    service.
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
    """The newest list that this robot has kept under a number above this one."""
    newer = sorted(((number, path) for number, path in _numbered(folder).items() if number > above), reverse=True)
    lists = (_read(path, cas) for _, path in newer)
    return next((each for each in lists if each is not None and each.number > above), None)


def _numbered(folder: Path) -> dict[int, Path]:
    name = Path(certs.revocation.FILE_NAME)
    paths = {path.stem.removeprefix(f"{name.stem}-"): path for path in folder.glob(f"{name.stem}-*{name.suffix}")}
    return {int(number): path for number, path in paths.items() if number.isdecimal()}


def _read(path: Path, cas: "Sequence[x509.Certificate]") -> "RevocationList | None":
    try:
        return certs.revocation.read(path, cas)
    except certs.revocation.ForeignListError as error:
        # Those whom it shuts out have certificates of a CA that this robot does not know either.
        logger.warning("%s; nobody is shut out by it", error)
        return None


class OlderCa:
    """Who still comes with a certificate of the older of two CAs: counted for the metrics, and in a file for `check`.

    A CA that takes another's place has common names of its own, so the name alone says it. On one thread.
    """

    def __init__(self, kept: Kept | None, count: Callable[[int], None]) -> None:
        """`count` is called with how many they are, since the start."""
        self._first = None if kept is None else kept.first_number
        self._count = count
        self._names: set[str] = set()
        folder = runtime_directory()
        self._path = None if folder is None else folder / OLDER_CA
        self._write()

    def note(self, common_names: Collection[str]) -> None:
        """These are connected now."""
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
    """Who has come with one since the start of the service, as it has noted them. Raises OSError."""
    return ((runtime_directory() or SERVICE_RUNTIME) / OLDER_CA).read_text().split()
