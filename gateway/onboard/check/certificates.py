"""The robot's certificates: whether they are good, belong together, and who is shut out."""

import datetime as dt
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import zenoh
from cryptography import x509

from gateway import certs
from gateway.certs import expiry, revocation
from gateway.errors import ConfigError
from gateway.host.directories import state_to_read
from gateway.onboard.check.table import LET_READ, RESTART, SERVICE, CheckedRobot, Probe, Seen, failure, warning
from gateway.robot.zenoh_io import revoked
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import certificate_files, get, load_config

DENIED: Final = os.strerror(errno.EACCES)
_TLS: Final = "transport/link/tls"
_CA: Final = f"{_TLS}/root_ca_certificate"


def _expiries(robot: CheckedRobot) -> Iterator[Seen]:
    yield from expiries(robot.settings.zenoh.config, dt.datetime.now(dt.UTC))


def expiries(file: str, now: dt.datetime) -> Iterator[Seen]:
    """The certificates that the Zenoh file names, and for how long they are good."""
    seen = Seen(fault="", well="none are in use" if not file else f"{file} names none", early=False, left_days=10**6)
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
        yield seen


def mismatched(robot: CheckedRobot) -> Iterator[Seen]:
    """What does not belong together; nothing where no certificates are in use, or one cannot be read."""
    yield from _pairs(robot)
    yield from _lists(robot)


def _named(robot: CheckedRobot) -> tuple[zenoh.Config, list[x509.Certificate]] | None:
    file = robot.settings.zenoh.config
    try:
        config = load_config(Path(file)) if file else None
        ca = None if config is None else get(config, _CA)
        return (config, certs.files.read_certificates(Path(ca))) if config is not None and isinstance(ca, str) else None
    except ConfigError:  # another line reports it
        return None


def _pairs(robot: CheckedRobot) -> Iterator[Seen]:
    """Of what the robot listens with, and of what it dials a router with: mostly the same files."""
    found = _named(robot)
    if found is None:
        return
    config, cas = found
    names = ((f"{_TLS}/{side}_certificate", f"{_TLS}/{side}_private_key") for side in ("listen", "connect"))
    for certificate, key in dict.fromkeys(tuple(get(config, name) for name in pair) for pair in names):
        if not (isinstance(certificate, str) and isinstance(key, str)):
            continue
        try:
            own, public = certs.files.read_certificate(Path(certificate)), certs.files.read_key(Path(key)).public_key()
        except ConfigError:
            continue
        ca = Path(get(config, _CA))
        seen = Seen(
            certificate=certificate, key=key, ca=ca, folder=ca.parent, foreign=False, other_key=False,
            files=f"{{{ca.name},{Path(certificate).name},{Path(key).name}}}",
        )  # fmt: skip
        if not any(certs.authority.is_issued(own, each) for each in cas):
            yield Seen(**{**vars(seen), "foreign": True})
        if public != own.public_key():
            yield Seen(**{**vars(seen), "other_key": True})


def _lists(robot: CheckedRobot) -> Iterator[Seen]:
    """Each list that the service reads at its start: its own, and one that came with the certificates."""
    found, state = _named(robot), state_to_read(robot.settings.state.path)
    beside = Path(robot.settings.zenoh.config).absolute().parent
    for folder in (state, beside) if found is not None else ():
        if folder is not None:
            path = folder / revocation.REVOCATION_FILE
            try:
                revocation.read(path, found[1] if found else [])
            except revocation.ForeignListError:
                yield Seen(path=path, fault="")
            except ConfigError as error:
                yield Seen(path=path, fault=str(error))
            except PermissionError:  # the line of the state directory reports it
                continue


def _revoked(robot: CheckedRobot) -> Iterator[Seen]:
    """The list in force; nothing where the Zenoh file names no CA, or another line finds a list damaged."""
    try:
        config = service_config(robot.settings.zenoh)
    except ConfigError:
        return
    if any(_lists(robot)):
        return
    try:
        kept = revoked.revocation_state(config, robot.settings, started_by_systemd=False)
    except ConfigError as error:
        yield Seen(fault=str(error))
        return
    if kept is not None:
        found = kept.known
        well = f"there is no list: nobody is shut out. If somebody was, {_BRING}"
        if found is not None:
            well = f"list {found.number} of {found.date:%Y-%m-%d} shuts out {len(found.entries)}"
        yield Seen(fault="", well=well)


_RENEW: Final = f"{{fix}}, then: {RESTART}"
_BRING: Final = "where ca.key is: hexapod-gateway certs revoke --dir DIR brings the newest list"
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
        warning(lambda r: not r.fault, "{path} is of another authority, so nobody is shut out by it", _ANOTHER_LIST),
    )),
)
REVOKED: Final = Probe("revoked", _revoked, (failure(lambda r: r.fault, "{fault}", _BRING),), "{well}")
# fmt: on
