"""Probes of who reaches the robot: certificates, revocations, Zenoh's configuration, ports and access control."""

import datetime as dt
import errno
import json
import logging
import os
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import zenoh

from gateway import certs
from gateway.certs import access, revocation
from gateway.certs.zenoh_files import command_for_new_rules
from gateway.endpoints import host_and_port
from gateway.errors import ConfigError
from gateway.host.directories import state_to_read
from gateway.host.kernel_tables import listening
from gateway.onboard.check.table import LET_READ, RESTART, SERVICE, CheckedRobot, Probes, Rows, failure, warning, well
from gateway.own_command import this_command
from gateway.robot.zenoh_io import exposure
from gateway.robot.zenoh_io.late_addresses import bind_fault, is_late
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import certificate_files, get, listen_endpoints

DENIED: Final = os.strerror(errno.EACCES)
_TLS: Final = "transport/link/tls"
_CA: Final = f"{_TLS}/root_ca_certificate"
_LAST_PORT: Final = 65_535
_NO_PORT: Final = OSError(errno.EINVAL, f"ports end at {_LAST_PORT}")  # getaddrinfo would take the lower 16 bits
_NO_LIST: Final = (
    "there is no list: nobody is shut out. If somebody was, send the newest list from where ca.key is: "
    "hexapod-gateway certs revoke --dir DIR"
)
_TO_FILE: Final = f"copy {revocation.REVOCATION_FILE} from the folder of certificates (where ca.key is) to FILE here"

logging.getLogger("gateway").addHandler(logging.NullHandler())  # what `service_config` warns of is a line here


def _configuration(robot: CheckedRobot) -> zenoh.Config | None:
    """Return the service's Zenoh configuration; None if it cannot be used, which the line `Zenoh` reports."""
    with suppress(ConfigError):
        return service_config(robot.settings.zenoh)
    return None


# ---- certificates


def validity(robot: CheckedRobot, now: dt.datetime | None = None) -> Iterator[Rows]:
    """How long the certificates that the Zenoh file names are valid."""
    config, now = _configuration(robot), now or dt.datetime.now(dt.UTC)
    if config is None:
        return
    found = list(map(certs.folder.describe, certificate_files(config)))
    if not found:
        yield [well("none are in use")]
    for each in found:
        end, left_days = f"{each.not_after:%Y-%m-%d}", each.days_left(now)
        renew = f"{certs.how_to_renew(each.path.name, each.role, each.name)}, then: {RESTART}"
        yield [
            failure(now < each.not_before, f"{each.path} is valid only from {each.not_before:%Y-%m-%d}",
                    "set the clock (timedatectl)"),
            failure(left_days < 0, f"{each.path} expired on {end}: nobody can connect", renew),
            warning(left_days < certs.WARN_DAYS, f"{each.path} is good until {end}, {left_days} days more", renew),
            well(f"{each.path} is good until {end}"),
        ]  # fmt: skip


def _pairs(robot: CheckedRobot) -> Iterator[Rows]:
    """The certificate and key for listening, and those for dialling a router: mostly the same files."""
    config, parts = _configuration(robot) or zenoh.Config(), ("certificate", "private_key")
    pairs = {tuple(get(config, f"{_TLS}/{side}_{part}") for part in parts): side for side in ("connect", "listen")}
    for names, side in pairs.items():
        with suppress(ConfigError, TypeError):  # none is named, or the key is of another kind
            ca, certificate, key = map(Path, (get(config, _CA), *names))
            own, role = certs.files.read_certificate(certificate), certs.folder.describe(certificate).role
            issued = any(certs.authority.is_issued(own, each) for each in certs.files.read_certificates(ca))
            from_one_folder = (
                f"copy gateway.json5 and {ca.name}, {certificate.name}, {key.name} from one folder of certificates "
                "(where ca.key is) to FOLDER here, then: sudo hexapod-gateway setup --certs FOLDER"
            )
            yield [
                failure(not issued, f"{certificate} is of another authority than {ca}: nobody can connect",
                        from_one_folder),
                failure(certs.files.read_key(key).public_key() != own.public_key(),
                        f"{key} is not the key of {certificate}: nobody can connect", from_one_folder),
                failure(side == "listen" and role != certs.authority.GATEWAY,
                        f"{certificate} is of {role}, not of a robot: laptops reject it", from_one_folder),
            ]  # fmt: skip


def _lists(robot: CheckedRobot) -> Iterator[Rows]:
    """Each revocation list that the service reads at its start but cannot use; without one, the list in force."""
    ca = get(_configuration(robot) or zenoh.Config(), _CA)
    if ca is None:
        return
    folders = (state_to_read(robot.settings.state.path), Path(robot.settings.zenoh.config).absolute().parent)
    known, unusable = list[revocation.RevocationList](), Rows()
    for path in (folder / revocation.REVOCATION_FILE for folder in folders if folder is not None):
        another = f"{_TO_FILE}, then: sudo install -m 644 -o {SERVICE} -g {SERVICE} FILE {path} && {RESTART}"
        try:
            known += filter(None, [revocation.read(path, certs.files.read_certificates(Path(ca)))])
        except revocation.ForeignListError:
            unusable += [warning(path, f"{path} is of another authority, so it shuts nobody out", another)]
        except ConfigError as error:
            unusable += [failure(error, f"{error}; the service does not start", another)]
    newest = max(known, key=lambda each: each.number, default=None)
    shuts_out = newest and f"list {newest.number} of {newest.date:%Y-%m-%d} shuts out {len(newest.entries)}"
    yield from [[each] for each in unusable] or [[well(shuts_out or _NO_LIST)]]


# ---- Zenoh


def _zenoh(robot: CheckedRobot) -> Iterator[Rows]:
    settings = robot.settings.zenoh
    try:
        config = service_config(settings)
    except ConfigError as error:
        for each in str(error).splitlines():
            yield [failure(DENIED in each, each, LET_READ), failure(each, each, "fix it there")]
    else:
        for each in list(exposure.warnings(config)) or [""]:
            yield [
                warning(each, each, "see docs/certificates.md for what each link needs"),
                well(settings.config or "its configuration is these settings alone"),
            ]


def _ports(robot: CheckedRobot) -> Iterator[Rows]:
    """Each endpoint on which the service listens."""
    if (config := _configuration(robot)) is not None:
        yield from (port(robot, each) for each in listen_endpoints(config))
        yield [] if listen_endpoints(config) else [well("none: the gateway does not listen, and dials others")]
    if metrics := robot.settings.telemetry.metrics:
        yield port(robot, f"tcp/{metrics}", "telemetry.metrics")


def port(robot: CheckedRobot, endpoint: str, setting: str = "zenoh.listen") -> Rows:
    """Return whether the service can listen on `endpoint`, or a gateway does already."""
    number = host_and_port(endpoint)[1]
    fault = bind_fault(endpoint) if not number.isdecimal() or int(number) <= _LAST_PORT else _NO_PORT
    if fault is None:
        return [well(f"{endpoint} {'is free' if number.isdecimal() else 'was not tried: it names no port'}")]
    kind = socket.SOCK_DGRAM if endpoint.startswith(("udp/", "quic/")) else socket.SOCK_STREAM
    taken, users = fault.errno == errno.EADDRINUSE, {uid for _, uid in listening(int(number), kind)}
    ours = robot.gateway_runs or (robot.service is not None and robot.service[0] in users)
    return [
        well(f"{endpoint} is in use by the running gateway") if taken and ours else None,
        failure(taken, f"{endpoint} is taken by another program",
                f"find that program (ss -ltnp), or set another {setting}"),
        warning(is_late(fault), f"{endpoint} is not there yet ({fault.strerror}): the service keeps trying, and "
                "listens on the others", f"see the addresses of this machine (ip address), or set another {setting}"),
        failure(fault, f"{endpoint} cannot be listened on: {fault.strerror}",
                f"set another {setting}: an address of this machine (ip address), a port from 1024 to 65535"),
    ]  # fmt: skip


def _access(robot: CheckedRobot) -> Iterator[Rows]:
    """The rules of this release that a file made by `certs` lacks, because it is older or was edited."""
    file, config = robot.settings.zenoh.config, _configuration(robot) or zenoh.Config()
    control, namespace = get(config, "access_control") or {}, get(config, "namespace") or ""
    rules = {each["id"]: each for each in control.get("rules") or []}
    if not control.get("enabled") or rules.keys().isdisjoint(each.what for each in access.TRAFFIC):
        return  # made by hand
    listed = {rule for each in control.get("policies") or [] for rule in each["rules"]}
    wanted = json.loads(json.dumps([access.rule(each, namespace) for each in access.TRAFFIC]))
    lost = ", ".join(each["id"] for each in wanted if each != rules.get(each["id"]) or each["id"] not in listed)
    ports = (re.search(r":(\d+)$", each) for each in listen_endpoints(config))
    anew = command_for_new_rules(file, next((int(found[1]) for found in ports if found), 7447), this_command())
    yield [
        warning(lost, f"{file} silently drops messages: {lost}", f"make it anew: {anew} && {RESTART}"),
        well("lets all of this gateway's keys through"),
    ]


PROBES: Final[Probes] = {
    "certificates": validity, "key pair": _pairs, "revoked": _lists, "Zenoh": _zenoh,
    "access control": _access, "port": _ports,
}  # fmt: skip
