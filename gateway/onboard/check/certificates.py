"""The robot's certificates: whether they are good, belong together and to this robot, and who is shut out."""

import datetime as dt
import errno
import os
import socket
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
_ALWAYS_DAYS: Final = 10**6


def _expiries(robot: CheckedRobot) -> Iterator[Seen]:
    return expiries(robot.settings.zenoh.config, dt.datetime.now(dt.UTC))


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
        well = f"{file} names none" if file else "none are in use"
        yield Seen(fault="", well=well, early=False, left_days=_ALWAYS_DAYS)


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
    if (found := _named(robot)) is None:
        return
    config, ca, cas = found
    parts, hosts_of = ("certificate", "private_key"), certs.authority.hosts_of
    pairs = {tuple(get(config, f"{_TLS}/{side}_{part}") for part in parts): side for side in ("connect", "listen")}
    for names, side in pairs.items():
        with suppress(ConfigError, TypeError):  # it names none; or another line reports it
            certificate, key = map(Path, names)
            own = certs.files.read_certificate(certificate)
            yield Seen(
                certificate=certificate, key=key, ca=ca, role=certs.folder.describe(certificate).role,
                files=f"{ca.name}, {certificate.name}, {key.name}", listens=side == "listen",
                foreign=not any(certs.authority.is_issued(own, each) for each in cas), hosts=", ".join(hosts_of(own)),
                other_key=certs.files.read_key(key).public_key() != own.public_key(),
                here=any(map(_is_here, hosts_of(own))), host=socket.gethostname(),
            )  # fmt: skip


def _is_here(host: str) -> bool:
    """Whether a name or an address is this machine's. Nobody is asked for it."""
    name = socket.gethostname().partition(".")[0].lower()
    if host.partition(".")[0].lower() in (name, "localhost"):
        return True
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with suppress(OSError, UnicodeError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        if family == socket.AF_INET6 or host.replace(".", "").isdigit():
            probe.bind((host, 0))
            return True
    return False


def _lists(robot: CheckedRobot) -> Iterator[Seen]:
    """Each list that the service reads at its start and cannot use: its own, or one that came with the certificates.

    If there is no such list: the one in force.
    """
    if (found := _named(robot)) is None:
        return
    folders = (state_to_read(robot.settings.state.path), Path(robot.settings.zenoh.config).absolute().parent)
    known, well = list[revocation.RevocationList](), ""
    for path in (folder / revocation.REVOCATION_FILE for folder in folders if folder is not None):
        try:
            known += [each] if (each := revocation.read(path, found[2])) is not None else []
        except ConfigError as error:
            foreign, well = isinstance(error, revocation.ForeignListError), "-"
            yield Seen(path=path, fault="" if foreign else str(error), foreign=foreign)
    newest = max(known, key=lambda each: each.number, default=None)
    if not well:
        shuts_out = newest and f"list {newest.number} of {newest.date:%Y-%m-%d} shuts out {len(newest.entries)}"
        yield Seen(fault="", foreign=False, well=shuts_out or _NO_LIST)


_RENEW: Final = f"{{fix}}, then: {RESTART}"
_NO_LIST: Final = (
    "there is no list: nobody is shut out. If somebody was, where ca.key is: hexapod-gateway certs revoke --dir DIR "
    "brings the newest list"
)
_FROM_ONE_FOLDER: Final = (
    "copy gateway.json5 and {files} from one folder of certificates (where ca.key is) to FOLDER here, then: "
    "sudo hexapod-gateway setup --certs FOLDER"
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
        failure(lambda r: r.listens and r.role != certs.authority.GATEWAY,
                "{certificate} is of {role}, not of a robot: laptops reject it", _FROM_ONE_FOLDER),
        warning(lambda r: r.listens and not r.here, "{certificate} is good for {hosts}, and this machine is {host}: is "
                "it another robot's?", _FROM_ONE_FOLDER),
    )),
    Probe("revoked", _lists, (
        failure(lambda r: r.fault, "{fault}; the service does not start", _ANOTHER_LIST),
        warning(lambda r: r.foreign, "{path} is of another authority, so nobody is shut out by it", _ANOTHER_LIST),
    ), "{well}"),
)
# fmt: on
