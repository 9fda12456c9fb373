"""Probes of who reaches the robot: certificates, revocations, Zenoh's configuration, ports and access control."""

import datetime as dt
import errno
import json
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import zenoh

from gateway import certs
from gateway.certs import access, revocation
from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.directories import state_to_read
from gateway.onboard.check.table import (
    LET_READ,
    RESTART,
    SERVICE,
    CheckedRobot,
    Result,
    failure,
    first,
    held,
    warning,
    well,
)
from gateway.robot.zenoh_io import exposure
from gateway.robot.zenoh_io.session import bind_fault, is_late, service_config
from gateway.zenoh.config import CA, TLS, certificate_files, connect_endpoints, get, listen_endpoints
from gateway.zenoh.endpoints import host_and_port, ip_of

DENIED: Final = os.strerror(errno.EACCES)
_IPV6: Final = 6
_NO_LIST: Final = "there is no list: nobody is shut out. To send one: hexapod-gateway certs revoke --dir DIR"

logging.getLogger("gateway").addHandler(logging.NullHandler())  # what `service_config` warns of is a line here


# fmt: off
def _configuration(robot: CheckedRobot) -> zenoh.Config:
    """Return the service's Zenoh configuration; an empty one if it cannot be used, which the line `Zenoh` reports."""
    with suppress(ConfigError):
        return service_config(robot.settings.zenoh)
    return zenoh.Config()


def certificates(robot: CheckedRobot, now: dt.datetime | None = None) -> Iterator[Result | None]:
    """How long the certificates that the Zenoh file names are valid, and whether they and their keys belong together.

    Of these, one is for listening, and one for dialling a router: mostly they are the same.
    """
    config, now = _configuration(robot), now or dt.datetime.now(dt.UTC)
    for each in map(certs.folder.describe, certificate_files(config)):
        soon = certs.expires_soon(str(each.path), each.not_after, now)
        renew = f"{certs.how_to_renew(each.path.name, each.role, each.name)}, then: {RESTART}"
        own = socket.gethostname().partition(".")[0]
        foreign = bool(each.hosts) and not any(map(_is_own, each.hosts))
        yield first("certificates",
            failure(now < each.not_before, f"{each.path} is valid only from {each.not_before:%Y-%m-%d}",
                    "set the clock (timedatectl)"),
            failure(each.not_after <= now, f"{soon}: nobody can connect", renew),
            warning(soon, str(soon), renew),
            warning(foreign, f"{each.path} is for {', '.join(each.hosts)}, and this robot is {own}: laptops reach it "
                    "by none of these names", "where ca.key is: hexapod-gateway certs renew gateway --dir DIR --host "
                    f"{own}.local, and copy {each.path.name} here, then: {RESTART}"),
            well(f"{each.path} is good until {each.not_after:%Y-%m-%d}"))
    parts = ("certificate", "private_key")
    pairs = {tuple(get(config, f"{TLS}/{side}_{part}") for part in parts): side for side in ("connect", "listen")}
    for names, side in pairs.items():
        with suppress(ConfigError, TypeError):  # none is named, or the key is of another kind
            ca, certificate, key = map(Path, (get(config, CA), *names))
            fault = certs.folder.mismatch(ca, certificate, key, of_robot=side == "listen")
            yield first("certificates",
                failure(fault, f"{fault}: nobody can connect", f"copy gateway.json5 and {ca.name}, {certificate.name}, "
                        f"{key.name} from one folder of certificates (where ca.key is) to FOLDER here, then: "
                        "sudo hexapod-gateway setup --certs FOLDER"))


def _is_own(host: str) -> bool:
    """Return whether a certificate's host is an address or a name of this machine, in any domain."""
    address = ip_of(f"tcp/{host}:0")
    if address is not None:
        return bind_fault(f"tcp/{f'[{host}]' if address.version == _IPV6 else host}:0") is None
    return host.partition(".")[0].lower() in (socket.gethostname().partition(".")[0].lower(), "localhost")


def revoked(robot: CheckedRobot) -> Iterator[Result | None]:
    """Each revocation list that the service reads at its start but cannot use; without one, the list in force."""
    ca, known, unusable = get(_configuration(robot), CA), list[revocation.RevocationList](), False
    folders = (state_to_read(robot.settings.state.path), Path(robot.settings.zenoh.config).absolute().parent)
    for path in (folder / revocation.REVOCATION_FILE for folder in folders if folder is not None and ca is not None):
        try:
            known += filter(None, [revocation.read(path, certs.files.read_certificates(Path(ca)))])
        except ConfigError as error:
            unusable = True
            another = (f"copy {revocation.REVOCATION_FILE} from the folder of certificates (where ca.key is) to FILE "
                       f"here, then: sudo install -m 644 -o {SERVICE} -g {SERVICE} FILE {path} && {RESTART}")
            yield first("revoked",
                warning(isinstance(error, revocation.ForeignListError), f"{path} is of another authority, so it shuts "
                        "nobody out", another),
                failure(error, f"{error}; the service does not start", another))
    newest = max(known, key=lambda each: each.number, default=None)
    shuts_out = newest and f"list {newest.number} of {newest.date:%Y-%m-%d} shuts out {len(newest.entries)}"
    yield None if ca is None or unusable else first("revoked", well(shuts_out or _NO_LIST))


def network(robot: CheckedRobot) -> Iterator[Result | None]:
    """The Zenoh configuration, its access rules, and each endpoint on which the service listens."""
    settings, metrics = robot.settings.zenoh, robot.settings.telemetry.metrics
    if metrics:
        yield port(robot, f"tcp/{metrics}", "telemetry.metrics")
    try:
        config = service_config(settings)
    except ConfigError as error:
        for each in str(error).splitlines():
            yield first("Zenoh", failure(DENIED in each, each, LET_READ), failure(each, each, "fix it there"))
        return
    for each in list(exposure.warnings(config)) or [""]:
        yield first("Zenoh", warning(each, each, "see docs/certificates.md for what each link needs"),
                    well(settings.config or "its configuration is these settings alone"))
    control, namespace = get(config, "access_control") or {}, get(config, "namespace") or ""
    rules = {each["id"]: each for each in control.get("rules") or []}
    if control.get("enabled") and not rules.keys().isdisjoint(each.what for each in access.TRAFFIC):  # made by `certs`
        listed = {rule for each in control.get("policies") or [] for rule in each["rules"]}
        wanted = json.loads(json.dumps([access.rule(each, namespace) for each in access.TRAFFIC]))
        lost = ", ".join(each["id"] for each in wanted if each != rules.get(each["id"]) or each["id"] not in listed)
        yield first("access control",
            warning(lost, f"{settings.config} silently drops messages: {lost}", "compare an edited file with one of "
                    "hexapod-gateway certs init --host HOST --dir NEW; for another: sudo hexapod-gateway setup"),
            well("lets all of this gateway's keys through"))
    endpoints, dials = listen_endpoints(config), connect_endpoints(config)
    nowhere = not dials and all((fault := bind_fault(each)) is not None and is_late(fault) for each in endpoints)
    yield from (port(robot, each, nowhere=nowhere) for each in endpoints)
    if not endpoints:
        yield first("port", well("none: the gateway does not listen, and dials others"))


def port(
    robot: CheckedRobot, endpoint: str, setting: str = "zenoh.listen", *, nowhere: bool = False
) -> Result | None:
    """Return whether the service can listen on `endpoint`, or a gateway does already; `nowhere`: on none of all."""
    fault = bind_fault(endpoint)
    taken, why = fault is not None and fault.errno == errno.EADDRINUSE, fault and fault.strerror
    holders = robot.open_files.listeners(endpoint) if taken else []
    ours = taken and (holders or robot.gateway_runs or effective.running() is not None)
    free = "is free" if host_and_port(endpoint)[1].isdecimal() else "was not tried: it names no port"
    return first("port",
        held(endpoint, robot.others(holders), f"set another {setting}, or, "),
        well(f"{endpoint} is in use by the running gateway") if ours else None,
        failure(taken, f"{endpoint} is held by another program",
                f"set another {setting}; this names the program: sudo hexapod-gateway check"),
        failure(nowhere, f"{endpoint} is not there ({why}), nor any other endpoint: the service runs, and nobody can "
                f"reach it", f"set {setting} to addresses that this machine has, such as tcp/127.0.0.1:7447 "
                f"(ip address lists them), then: {RESTART}"),
        warning(fault and is_late(fault), f"{endpoint} is not there yet ({why}): the service keeps trying, and listens "
                "on the others", f"see the addresses of this machine (ip address), or set another {setting}"),
        failure(fault, f"{endpoint} cannot be listened on: {why}",
                f"set another {setting}: an address of this machine (ip address), a port from 1024 to 65535"),
        well(f"{endpoint} {free}"))


# fmt: on
PROBES: Final = (certificates, revoked, network)
