"""Who may come, and who is shut out: at the robot, and on the laptop itself."""

import datetime as dt
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import zenoh

from gateway import certs
from gateway.certs import pool
from gateway.errors import ConfigError
from gateway.onboard.check.result import Result, failure, ok, warning
from gateway.people.client.requests import Identity
from gateway.people.terminal import this_command
from gateway.robot.sections import ZenohSettings
from gateway.robot.zenoh_io import revoked
from gateway.zenoh_config import get
from schemas.telemetry import RevocationsReport

_NAME: Final = "laptops"
_LIST: Final = "revoked"
_BRING: Final = "where ca.key is: hexapod-gateway certs revoke --dir DIR brings the newest list"
_CA: Final = "transport/link/tls/root_ca_certificate"


def at_the_robot(config: zenoh.Config, file: str) -> Iterator[Result]:
    """Of a gateway's own configuration; nothing where it knows no roles."""
    listed = [
        pool.holder(name)
        for subject in get(config, "access_control/subjects") or []
        for name in subject.get("cert_common_names") or []
    ]
    laptops = [each for each in listed if each.role in certs.LAPTOP_ROLES]
    if laptops and not any(each.number is not None for each in laptops):
        yield warning(
            _NAME,
            f"{file} knows one common name for all operators, so a lost laptop cannot be shut out alone",
            f"sudo {this_command()} certs pool --dir {Path(file).parent} && sudo systemctl restart hexapod-gateway; "
            "where ca.key is, the same (certs pool), and then certs reissue for each laptop",
        )
    yield from _of_two_cas(config)


def _of_two_cas(config: zenoh.Config) -> Iterator[Result]:
    ca = get(config, _CA)
    try:
        if not isinstance(ca, str) or len(certs.files.read_certificates(Path(ca))) == 1:
            return
    except ConfigError:  # another row reports it
        return
    try:
        still = revoked.of_older_ca()
    except OSError:
        yield warning(_NAME, f"{ca} has two CAs; nobody has noted who still uses the older one", "start the service")
        return
    if not still:
        yield ok(_NAME, "nobody has come with a certificate of the older CA since the service's start")
        return
    sentence = f"{len(still)} came with a certificate of the older CA since the service's start: {', '.join(still)}"
    yield warning(_NAME, sentence, "where ca.key is: hexapod-gateway certs reissue NAME (certs list has the names)")


def shut_out_at_the_robot(config: zenoh.Config, settings: ZenohSettings) -> Iterator[Result]:
    """The list in force; nothing where the Zenoh file names no CA."""
    try:
        kept = revoked.revocation_state(config, settings, started_by_systemd=False)
    except ConfigError as error:
        yield failure(_LIST, str(error), _BRING)
        return
    if kept is None:
        return
    if kept.known is None:
        yield ok(_LIST, f"there is no list: nobody is shut out. If somebody was, {_BRING}")
        return
    sentence = f"{_of(kept.known.number, kept.known.date)} shuts out {len(kept.known.entries)}"
    if kept.stale is None:
        yield ok(_LIST, sentence)
        return
    place = f"list {kept.stale} lies" if kept.stale else "no list lies"
    yield warning(
        _LIST,
        f"{sentence}, but {place} in its place ({kept.path}): was a backup restored?",
        f"start the service, which keeps to the newest that this robot has seen; {_BRING}",
    )


def shut_out_from_the_laptop(there: RevocationsReport | None, identity: Identity) -> Iterator[Result]:
    """The list in force at the robot, and whether it is older than that in the laptop's own folder."""
    if identity.ca is None:
        return
    said = "the robot names no list of revoked certificates"
    if there is not None:
        said = f"the robot goes by {_of(there.number, there.date)}"
    folder = identity.ca.parent
    try:
        own = certs.folder.revoked(folder)
    except ConfigError as error:
        yield warning(_LIST, str(error), "restore it from a copy of the folder")
        return
    if own is not None and own.number > (0 if there is None else there.number):
        fix = f"{this_command()} certs revoke --dir {folder}"
        yield warning(_LIST, f"{said}; {folder} has {_of(own.number, own.date)}", fix)
    else:
        yield ok(_LIST, said)


def _of(number: int, date: dt.datetime) -> str:
    return f"list {number} of {date:%Y-%m-%d}"


def on_the_laptop(identity: Identity) -> Iterator[Result]:
    """Of one's own certificate."""
    if identity.certificate is None or identity.ca is None:
        return
    try:
        own, cas = certs.folder.describe(identity.certificate), certs.files.read_certificates(identity.ca)
    except ConfigError:  # another row reports it
        return
    fix = f"hexapod-gateway certs reissue {own.path.stem}, where ca.key is, and bring its files here"
    if own.role.partition(".")[0] in certs.LAPTOP_ROLES and pool.holder(own.common_name).number is None:
        yield warning(
            _NAME,
            f"{own.path.name} has the common name {own.common_name}, as all others: it cannot be revoked alone",
            fix,
        )
    elif len(cas) > 1 and not certs.authority.is_issued(certs.files.read_certificate(own.path), cas[0]):
        yield warning(_NAME, f"{own.path.name} is of the older of two CAs, whose time ends", fix)
