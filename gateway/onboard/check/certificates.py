"""The robot's certificates: whether they are good, belong together, and who is shut out."""

import datetime as dt
import errno
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import zenoh
from cryptography import x509

from gateway import certs
from gateway.certs import expiry, revocation
from gateway.errors import ConfigError
from gateway.host.directories import state_to_read
from gateway.onboard.check.table import LET_READ, RESTART, SERVICE, CheckedRobot, Probe, Seen, failure, warning
from gateway.zenoh_config import certificate_files, get, load_config

DENIED: Final = os.strerror(errno.EACCES)
_TLS: Final = "transport/link/tls"


def _expiries(robot: CheckedRobot) -> Iterator[Seen]:
    yield from expiries(robot.settings.zenoh.config, dt.datetime.now(dt.UTC))


def expiries(file: str, now: dt.datetime) -> Iterator[Seen]:
    """The certificates that the Zenoh file names, and for how long they are good."""
    try:
        found = list(map(certs.folder.describe, certificate_files(load_config(Path(file))))) if file else []
    except ConfigError as error:
        yield Seen(fault=str(error), denied=DENIED in str(error))
        return
    for each in found:
        yield Seen(
            fault="", path=each.path, begin=each.not_before, end=each.not_after, early=now < each.not_before,
            left_days=each.days_left(now), fix=expiry.remedy(each.path.name, each.role, each.name),
            well=f"{each.path} is good until {each.not_after:%Y-%m-%d}",
        )  # fmt: skip
    if not found:
        yield Seen(fault="", well=f"{file} names none" if file else "none are in use", early=False, left_days=10**6)


def _named(robot: CheckedRobot) -> tuple[zenoh.Config, Path, list[x509.Certificate]] | None:
    """The Zenoh file and its authorities; None without any, or where another line reports that they cannot be read."""
    with suppress(ConfigError):
        config = load_config(Path(robot.settings.zenoh.config)) if robot.settings.zenoh.config else zenoh.Config()
        ca = get(config, f"{_TLS}/root_ca_certificate")
        if isinstance(ca, str):
            return config, Path(ca), certs.files.read_certificates(Path(ca))
    return None


def _pairs(robot: CheckedRobot) -> Iterator[Seen]:
    """What the robot listens with, and what it dials a router with: mostly the same files."""
    found = _named(robot)
    if found is None:
        return
    config, ca, cas = found
    names = ((f"{_TLS}/{side}_certificate", f"{_TLS}/{side}_private_key") for side in ("listen", "connect"))
    for certificate, key in dict.fromkeys(tuple(get(config, name) for name in pair) for pair in names):
        with suppress(ConfigError, TypeError):  # it names none; or another line reports it
            own, public = certs.files.read_certificate(Path(certificate)), certs.files.read_key(Path(key)).public_key()
            files = f"{{{ca.name},{Path(certificate).name},{Path(key).name}}}"
            seen = Seen(certificate=certificate, key=key, ca=ca, folder=ca.parent, files=files)
            seen.foreign = not any(certs.authority.is_issued(own, each) for each in cas)
            seen.other_key = public != own.public_key()
            yield seen


def _lists(robot: CheckedRobot) -> Iterator[Seen]:
    """Each list that the service reads at its start and cannot use: its own, or one that came with the certificates.

    If there is no such list: the one in force.
    """
    found = _named(robot)
    if found is None:
        return
    folders = (state_to_read(robot.settings.state.path), Path(robot.settings.zenoh.config).absolute().parent)
    known, faults = list[revocation.RevocationList](), list[Seen]()
    for path in (folder / revocation.REVOCATION_FILE for folder in folders if folder is not None):
        try:
            known += [each] if (each := revocation.read(path, found[2])) is not None else []
        except ConfigError as error:
            foreign = isinstance(error, revocation.ForeignListError)
            faults.append(Seen(path=path, fault="" if foreign else str(error), foreign=foreign))
    newest, well = (
        max(known, key=lambda each: each.number, default=None),
        _NO_LIST,
    )
    if newest is not None:
        well = f"list {newest.number} of {newest.date:%Y-%m-%d} shuts out {len(newest.entries)}"
    yield from faults or [Seen(fault="", foreign=False, well=well)]


_RENEW: Final = f"{{fix}}, then: {RESTART}"
_NO_LIST: Final = (
    "there is no list: nobody is shut out. If somebody was, where ca.key is: hexapod-gateway certs revoke --dir DIR "
    "brings the newest list"
)
_FROM_ONE_FOLDER: Final = (
    "copy these from one folder of certificates (where ca.key is) to FOLDER here, then: sudo cp FOLDER/{files} {folder}"
    f" && {LET_READ.partition(': ')[2]}"
)
_ANOTHER_LIST: Final = (
    f"copy {revocation.REVOCATION_FILE} from the folder of certificates (where ca.key is) to FILE here, then: "
    f"sudo install -m 644 -o {SERVICE} -g {SERVICE} FILE {{path}} && {RESTART}"
)
# fmt: off
CERTIFICATES: Final = (
    Probe("certificates", _expiries, (
        failure(lambda r: r.fault and r.denied, "{fault}", LET_READ),
        failure(lambda r: r.fault, "{fault}", "until then nobody can connect, and the service does not start"),
        failure(lambda r: r.early, "{path} is good only from {begin:%Y-%m-%d}", "set the clock (timedatectl)"),
        failure(lambda r: r.left_days < 0, "{path} expired on {end:%Y-%m-%d}: nobody can connect", _RENEW),
        warning(lambda r: r.left_days < expiry.WARN_DAYS, "{well}, {left_days} days more", _RENEW),
    ), "{well}"),
    Probe("certificates", _pairs, (
        failure(lambda r: r.foreign, "{certificate} is of another authority than {ca}: nobody can connect",
                _FROM_ONE_FOLDER),
        failure(lambda r: r.other_key, "{key} is not the key of {certificate}: nobody can connect", _FROM_ONE_FOLDER),
    )),
    Probe("revoked", _lists, (
        failure(lambda r: r.fault, "{fault}; the service does not start", _ANOTHER_LIST),
        warning(lambda r: r.foreign, "{path} is of another authority, so nobody is shut out by it", _ANOTHER_LIST),
    ), "{well}"),
)
# fmt: on
