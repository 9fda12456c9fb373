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
from cryptography import x509

from gateway import certs
from gateway.certs import access, revocation
from gateway.certs.access import TRAFFIC
from gateway.certs.zenoh_files import command_for_new_rules
from gateway.endpoints import host_and_port
from gateway.errors import ConfigError
from gateway.host.directories import state_to_read
from gateway.host.kernel_tables import listening
from gateway.onboard.check.table import LET_READ, RESTART, SERVICE, CheckedRobot, Probe, Seen, failure, warning
from gateway.own_command import this_command
from gateway.robot.zenoh_io import exposure
from gateway.robot.zenoh_io.late_addresses import bind_fault, is_late
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import certificate_files, get, listen_endpoints, load_config

DENIED: Final = os.strerror(errno.EACCES)
_TLS: Final = "transport/link/tls"
_LAST_PORT: Final = 65_535
_NO_PORT: Final = OSError(errno.EINVAL, f"ports end at {_LAST_PORT}")  # getaddrinfo would take the lower 16 bits

logging.getLogger("gateway").addHandler(logging.NullHandler())  # what `service_config` warns of is a line here


# ---- certificates


def expiries(robot: CheckedRobot, now: dt.datetime | None = None) -> Iterator[Seen]:
    """Read the certificates that the Zenoh file names, and how long they are valid."""
    file, now, found = robot.settings.zenoh.config, now or dt.datetime.now(dt.UTC), list[certs.folder.Certificate]()
    try:
        found = list(map(certs.folder.describe, certificate_files(load_config(Path(file))))) if file else []
    except ConfigError as error:
        yield Seen(fault=str(error))
    else:
        if not found:
            yield Seen(fault="", well=f"{file} names none" if file else "none are in use", early=False, left_days=9999)
    for each in found:
        fix, well = certs.how_to_renew(each.path.name, each.role, each.name), f"is good until {each.not_after:%Y-%m-%d}"
        early, left_days = now < each.not_before, each.days_left(now)
        yield Seen(fault="", each=each, early=early, left_days=left_days, fix=fix, well=f"{each.path} {well}")


def _named(robot: CheckedRobot) -> tuple[zenoh.Config, Path, list[x509.Certificate]] | None:
    """Return the Zenoh file and its authorities; None without authorities, or if another line reports a fault."""
    with suppress(ConfigError):
        config = load_config(Path(robot.settings.zenoh.config)) if robot.settings.zenoh.config else zenoh.Config()
        if isinstance(ca := get(config, f"{_TLS}/root_ca_certificate"), str):
            return config, Path(ca), certs.files.read_certificates(Path(ca))
    return None


def _pairs(robot: CheckedRobot) -> Iterator[Seen]:
    """Read the certificate and key for listening, and those for dialling a router: mostly the same files."""
    if (found := _named(robot)) is None:
        return
    config, ca, cas = found
    parts = ("certificate", "private_key")
    pairs = {tuple(get(config, f"{_TLS}/{side}_{part}") for part in parts): side for side in ("connect", "listen")}
    for names, side in pairs.items():
        with suppress(ConfigError, TypeError):  # none is named, or another line reports it
            certificate, key = map(Path, names)
            own, role = certs.files.read_certificate(certificate), certs.folder.describe(certificate).role
            hosts, listens = certs.authority.hosts_of(own), side == "listen"
            yield Seen(
                certificate=certificate, key=key, ca=ca, role=role, files=f"{ca.name}, {certificate.name}, {key.name}",
                foreign=not any(certs.authority.is_issued(own, each) for each in cas), hosts=", ".join(hosts),
                other_key=certs.files.read_key(key).public_key() != own.public_key(), listens=listens,
                here=any(map(_is_here, hosts)), host=socket.gethostname(),
            )  # fmt: skip


def _is_here(host: str) -> bool:
    """Return whether a name or address is this machine's, without a DNS query."""
    if host.partition(".")[0].lower() in (socket.gethostname().partition(".")[0].lower(), "localhost"):
        return True
    is_address = ":" in host or host.replace(".", "").isdigit()  # a name would have to be resolved
    return is_address and bind_fault(f"udp/[{host}]:0" if ":" in host else f"udp/{host}:0") is None


def _lists(robot: CheckedRobot) -> Iterator[Seen]:
    """Read each revocation list that the service reads at its start but cannot use; without one, the list in force."""
    if (found := _named(robot)) is None:
        return
    folders = (state_to_read(robot.settings.state.path), Path(robot.settings.zenoh.config).absolute().parent)
    known, unusable = list[revocation.RevocationList](), False
    for path in (folder / revocation.REVOCATION_FILE for folder in folders if folder is not None):
        try:
            known += filter(None, [revocation.read(path, found[2])])
        except ConfigError as error:
            unusable = True
            yield Seen(path=path, fault=error, foreign=isinstance(error, revocation.ForeignListError))
    if not unusable:
        newest = max(known, key=lambda each: each.number, default=None)
        shuts_out = newest and f"list {newest.number} of {newest.date:%Y-%m-%d} shuts out {len(newest.entries)}"
        yield Seen(fault=None, foreign=False, well=shuts_out or _NO_LIST)


# ---- Zenoh


def configuration(robot: CheckedRobot) -> zenoh.Config | None:
    """Return the service's Zenoh configuration; None if another line reports why there is none."""
    with suppress(ConfigError):
        return service_config(robot.settings.zenoh)
    return None


def _zenoh(robot: CheckedRobot) -> Iterator[Seen]:
    settings = robot.settings.zenoh
    try:
        logged = list(exposure.warnings(service_config(settings)))
    except ConfigError as error:
        yield from (Seen(fault=each) for each in str(error).splitlines())
    else:
        well = settings.config or "its configuration is these settings alone"
        yield from (Seen(fault="", logged=each, well=well) for each in logged or [""])


def _ports(robot: CheckedRobot) -> Iterator[Seen]:
    """Read each endpoint on which the service listens."""
    config = configuration(robot)
    endpoints = [] if config is None else listen_endpoints(config)
    yield from (port(robot, each) for each in endpoints)
    if config is not None and not endpoints:
        yield Seen(where="none:", taken=False, late=False, why="", well="the gateway does not listen, and dials others")
    if metrics := robot.settings.telemetry.metrics:
        yield port(robot, f"tcp/{metrics}", "telemetry.metrics")


def port(robot: CheckedRobot, endpoint: str, setting: str = "zenoh.listen") -> Seen:
    """Return a reading: whether the service can listen on `endpoint`, or a gateway does already."""
    number = host_and_port(endpoint)[1]
    fault = bind_fault(endpoint) if not number.isdecimal() or int(number) <= _LAST_PORT else _NO_PORT
    well = "is free" if number.isdecimal() else "was not tried: it names no port"
    seen = Seen(where=endpoint, setting=setting, why=fault and fault.strerror, late=fault and is_late(fault), well=well)
    seen.taken = fault is not None and fault.errno == errno.EADDRINUSE
    kind = socket.SOCK_DGRAM if endpoint.startswith(("udp/", "quic/")) else socket.SOCK_STREAM
    ours = robot.service and robot.service[0]
    if seen.taken and (robot.gateway_runs or ours in {uid for _, uid in listening(int(number), kind)}):
        seen.well, seen.taken, seen.why = "is in use by the running gateway", False, ""
    return seen


def _access(robot: CheckedRobot) -> Seen | None:
    """Read the rules of this release that a file made by `certs` lacks, because it is older or was edited."""
    config, file = configuration(robot), robot.settings.zenoh.config
    if config is None:
        return None
    control, namespace = get(config, "access_control") or {}, get(config, "namespace") or ""
    rules = {each["id"]: each for each in control.get("rules") or []}
    if not control.get("enabled") or rules.keys().isdisjoint(each.what for each in TRAFFIC):
        return None  # made by hand
    listed = {rule for each in control.get("policies") or [] for rule in each["rules"]}
    wanted = json.loads(json.dumps([access.rule(each, namespace) for each in TRAFFIC]))
    lost = ", ".join(each["id"] for each in wanted if each != rules.get(each["id"]) or each["id"] not in listed)
    ports = (re.search(r":(\d+)$", each) for each in listen_endpoints(config))
    anew = command_for_new_rules(file, next((int(found[1]) for found in ports if found), 7447), this_command())
    return Seen(file=file, lost=lost, anew=f"{anew} && {RESTART}")


_RENEW: Final = f"{{fix}}, then: {RESTART}"
_NO_LIST: Final = (
    "there is no list: nobody is shut out. If somebody was, send the newest list from where ca.key is: "
    "hexapod-gateway certs revoke --dir DIR"
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
    Probe("certificates", expiries, (
        failure(lambda r: DENIED in r.fault, "{fault}", LET_READ),
        failure(lambda r: r.fault, "{fault}", "until then nobody can connect, and the service does not start"),
        failure(lambda r: r.early, "{each.path} is valid only from {each.not_before:%Y-%m-%d}",
                "set the clock (timedatectl)"),
        failure(lambda r: r.left_days < 0, "{each.path} expired on {each.not_after:%Y-%m-%d}: nobody can connect",
                _RENEW),
        warning(lambda r: r.left_days < certs.WARN_DAYS, "{well}, {left_days} days more", _RENEW),
    ), "{well}"),
    Probe("certificates", _pairs, (
        failure(lambda r: r.foreign, "{certificate} is of another authority than {ca}: nobody can connect",
                _FROM_ONE_FOLDER),
        failure(lambda r: r.other_key, "{key} is not the key of {certificate}: nobody can connect", _FROM_ONE_FOLDER),
        failure(lambda r: r.listens and r.role != certs.authority.GATEWAY,
                "{certificate} is of {role}, not of a robot: laptops reject it", _FROM_ONE_FOLDER),
        warning(lambda r: r.listens and not r.here, "{certificate} is for {hosts}, but this machine is {host}: is "
                "it another robot's?", _FROM_ONE_FOLDER),
    )),
    Probe("revoked", _lists, (
        warning(lambda r: r.foreign, "{path} is of another authority, so it shuts nobody out", _ANOTHER_LIST),
        failure(lambda r: r.fault, "{fault}; the service does not start", _ANOTHER_LIST),
    ), "{well}"),
)
ZENOH: Final = Probe("Zenoh", _zenoh, (
    failure(lambda r: DENIED in r.fault, "{fault}", LET_READ),
    failure(lambda r: r.fault, "{fault}", "fix it there"),
    warning(lambda r: r.logged, "{logged}", "see docs/certificates.md for what each link needs"),
), "{well}")
ACCESS: Final = Probe("access control", _access, (
    warning(lambda r: r.lost, "{file} silently drops messages: {lost}", "make it anew: {anew}"),
), "lets all of this gateway's keys through")
PORTS: Final = Probe("port", _ports, (
    failure(lambda r: r.taken, "{where} is taken by another program",
            "find that program (ss -ltnp), or set another {setting}"),
    warning(lambda r: r.late, "{where} is not there yet ({why}): the service keeps trying, and listens on the others",
            "see the addresses of this machine (ip address), or set another {setting}"),
    failure(lambda r: r.why, "{where} cannot be listened on: {why}",
            "set another {setting}: an address of this machine (ip address), a port from 1024 to 65535"),
), "{where} {well}")
# fmt: on
