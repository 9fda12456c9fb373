"""The network: Zenoh's configuration, ports, certificates."""

import datetime as dt
import errno
import json
import logging
import os
import re
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import zenoh
from pydantic import ValidationError

from gateway import certs
from gateway.certs import expiry
from gateway.errors import ConfigError, GatewayError, ZenohError
from gateway.host.sockets import listening
from gateway.onboard.check import service_user
from gateway.onboard.check.result import Result, failure, ok, warning
from gateway.onboard.check.trust import LET_READ
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Stage
from gateway.people.client.requests import Identity
from gateway.robot.sections import ZenohSettings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import certificate_files, connect_endpoints, load_config, one_line, open_session
from schemas.telemetry import GatewayState

DENIED: Final = os.strerror(errno.EACCES)
_ANSWER_S: Final = 1.0
_LAST_PORT: Final = 65_535
_LINKS: Final = {
    "tcp": socket.SOCK_STREAM,
    "tls": socket.SOCK_STREAM,
    "ws": socket.SOCK_STREAM,
    "udp": socket.SOCK_DGRAM,
    "quic": socket.SOCK_DGRAM,
}
_ENDPOINT: Final = re.compile(r"(?P<link>[a-z0-9-]+)/(?P<host>\[[^\]]+\]|[^:#?\[\]]+):(?P<port>\d{1,5})(?:[#?].*)?")


def zenoh_configuration(settings: ZenohSettings) -> tuple[zenoh.Config | None, list[Result]]:
    """The configuration that the service would open, and the warnings that it would log about it."""
    with _warnings_of("gateway") as warnings:
        try:
            config = service_config(settings)
        except ConfigError as error:
            lines = str(error).splitlines()
            return None, [failure("Zenoh", line, LET_READ if DENIED in line else "fix it there") for line in lines]
    found = [warning("Zenoh", line, "see docs/security.md for what each link needs") for line in warnings]
    return config, found or [ok("Zenoh", settings.config or "its configuration is these settings alone")]


def ports(endpoints: Sequence[str], *, gateway_runs: bool) -> list[Result]:
    """Each endpoint that the service would listen on. `gateway_runs`: then a port in use is the gateway's."""
    if not endpoints:
        return [ok("port", "none: the gateway listens nowhere, and dials others")]
    return [port(endpoint, gateway_runs=gateway_runs) for endpoint in endpoints]


def port(endpoint: str, *, gateway_runs: bool = False) -> Result:
    """Whether the service could listen on `endpoint`; a gateway that listens there already is fine."""
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or found["link"] not in _LINKS:
        return ok("port", f"{endpoint} was not tried: it names no port that could be")
    error = _listen(found["host"], int(found["port"]), _LINKS[found["link"]])
    taken = error is not None and error.errno == errno.EADDRINUSE
    if taken and (answer := _gateway_at(found) or _service_at(int(found["port"]), found["link"])):
        return ok("port", f"{endpoint} is in use by {answer}")
    if taken and gateway_runs:
        return ok("port", f"{endpoint} is in use by the gateway that runs here, it seems")
    return _verdict(endpoint, "zenoh.listen", error)


def opens(settings: ZenohSettings, endpoints: Sequence[str]) -> list[Result]:
    """What keeps Zenoh from listening there; nothing where it can: it is tried, on free ports of these addresses.

    Nobody is dialled, and a running gateway is not disturbed. `endpoints`: those whose ports can be had.
    """
    tried = [trial for each in endpoints if (trial := _on_a_free_port(each)) is not None]
    if not tried:
        return []
    config = service_config(settings)
    config.insert_json5("connect/endpoints", "[]")
    config.insert_json5("listen/endpoints", json.dumps(tried))
    try:
        open_session(config).close()
    except ZenohError as error:
        why = one_line(error.__cause__ or error)
        fix = "in zenoh.listen, write tls/ for tcp/, or leave it out: the Zenoh file has endpoints of its own"
        return [failure("Zenoh", f"cannot listen on {', '.join(endpoints)}: {why}", fix)]
    return []


def _on_a_free_port(endpoint: str) -> str | None:
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or found["link"] not in _LINKS:
        return None
    return f"{endpoint[: found.start('port')]}0{endpoint[found.end('port') :]}"


def routers(config: zenoh.Config) -> Iterator[Result]:
    """Whether what the gateway dials is there, as far as it can be seen without being the gateway."""
    endpoints = connect_endpoints(config)
    for endpoint, findings in diagnosis.look_at_all(endpoints, Identity.of(config)).items():
        # A port that speaks no TLS may well be a router's.
        last = next((each for each in reversed(findings) if each.stage is not Stage.GATEWAY), findings[-1])
        said = f"{endpoint}: {_of_a_router(last.sentence)}"
        if not last.fix:
            yield ok("router", said)
            continue
        fix = (
            "start it there (zenohd -c router.json5), or set another zenoh.connect; the gateway goes on trying"
            if last.stage in (Stage.NAME, Stage.TCP)
            else _of_a_router(last.fix)
        )
        yield failure("router", f"{said}: nobody behind it reaches this robot", fix)


def _of_a_router(sentence: str) -> str:
    return sentence.replace("the robot", "the router")


def metrics_port(address: str, *, gateway_runs: bool) -> Result:
    """Whether the metrics page could listen on `address`."""
    host, _, number = address.rpartition(":")
    error = _listen(host, int(number), socket.SOCK_STREAM)
    taken = error is not None and error.errno == errno.EADDRINUSE
    if taken and (gateway_runs or _service_at(int(number), "tcp")):
        return ok("port", f"{address} is in use by the gateway that runs here, it seems")
    return _verdict(address, "telemetry.metrics", error)


def _listen(host: str, number: int, kind: socket.SocketKind) -> OSError | None:
    """Why nothing could listen there now; None: it could. For a name, none of its addresses may be in use."""
    if number > _LAST_PORT:  # getaddrinfo would take the lower 16 bits
        return OSError(errno.EINVAL, f"ports end at {_LAST_PORT}")
    try:
        found = socket.getaddrinfo(host.strip("[]"), number, type=kind)
    except OSError as error:
        return error
    errors = [_bind(family, kind, address) for family, _, _, _, address in found]
    taken = [error for error in errors if error is not None and error.errno == errno.EADDRINUSE]
    return taken[0] if taken else None if None in errors else errors[0]


def _bind(family: socket.AddressFamily, kind: socket.SocketKind, address: Any) -> OSError | None:
    try:
        with socket.socket(family, kind) as probe:
            if kind is socket.SOCK_STREAM:  # as the listener does: a recently closed connection is no obstacle
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            if kind is socket.SOCK_STREAM:
                probe.listen(1)
    except OSError as error:
        return error
    return None


def _verdict(where: str, setting: str, error: OSError | None) -> Result:
    if error is None:
        return ok("port", f"{where} is free")
    sentence, fix = {
        errno.EADDRINUSE: ("is taken by another program", f"see whose it is (ss -ltnp), or set another {setting}"),
        errno.EADDRNOTAVAIL: ("is no address of this machine", f"set another {setting} (ip address shows them)"),
        errno.EACCES: ("may not be listened on by this user", f"set {setting} to a port above 1023"),
        errno.EAFNOSUPPORT: ("needs IPv6, which this kernel lacks", f"in {setting}, write 0.0.0.0 for [::]"),
    }.get(error.errno or 0, (f"cannot be listened on: {error.strerror}", f"set another {setting}"))
    return failure("port", f"{where} {sentence}", fix)


def _gateway_at(found: re.Match[str]) -> str:
    """The gateway that answers on a TCP endpoint of this machine, in words; "" where none does."""
    if found["link"] != "tcp":
        return ""  # TLS would demand a certificate
    host = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}.get(found["host"], found["host"])  # noqa: S104 (dialled, not opened)
    state = state_at(f"tcp/{host}:{found['port']}")
    if state is None:
        return ""
    return f"a gateway that is {state.mode}" + (", on a simulated controller" if state.simulated else "")


def state_at(endpoint: str) -> GatewayState | None:
    """What answers there; None: no gateway does."""
    try:
        with Client(endpoint, source="hexapod-gateway check", timeout_s=_ANSWER_S) as client:
            return client.state()
    except (GatewayError, ValidationError):
        return None


def _service_at(port: int, link: str) -> str:
    """The service, where the socket that has the port is its user's; it would answer nobody without a certificate."""
    service = service_user.uid()
    return "the service" if service is not None and service in owners(port, _LINKS[link]) else ""


def owners(port: int, kind: socket.SocketKind) -> set[int]:
    """The users (numbers) of the sockets that listen on a port, as the kernel shows everybody."""
    return {uid for _, uid in listening(port, kind)}


def certificates(settings: ZenohSettings, now: dt.datetime) -> list[Result]:
    """The certificates that the Zenoh file names, and for how long they are good."""
    name = "certificates"
    if not settings.config:
        return [ok(name, "none are in use")]
    try:
        found = [certs.folder.describe(path) for path in certificate_files(load_config(Path(settings.config)))]
    except ConfigError as error:
        fix = LET_READ if DENIED in str(error) else "until then nobody can connect, and the service does not start"
        return [failure(name, str(error), fix)]
    if not found:
        return [ok(name, f"{settings.config} names none")]
    return [_expiry(certificate, now) for certificate in found]


def _expiry(certificate: certs.folder.Certificate, now: dt.datetime) -> Result:
    name, path = "certificates", certificate.path
    until = f"good until {certificate.not_after:%Y-%m-%d}"
    fix = expiry.remedy(path.name, certificate.role, certificate.name)
    left_days = certificate.days_left(now)
    if now < certificate.not_before:
        return failure(
            name, f"{path} is good only from {certificate.not_before:%Y-%m-%d}", "set the clock (timedatectl)"
        )
    if left_days < 0:
        return failure(name, f"{path} expired on {certificate.not_after:%Y-%m-%d}: nobody can connect", fix)
    if left_days < expiry.WARN_DAYS:
        return warning(name, f"{path} is {until}, {left_days} days more", fix)
    return ok(name, f"{path} is {until}")


@contextmanager
def _warnings_of(logger_name: str) -> Iterator[list[str]]:
    """Collects the warnings logged meanwhile, which go nowhere else."""
    logged: list[str] = []

    class CollectLines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            logged.append(record.getMessage())

    logger, handler = logging.getLogger(logger_name), CollectLines(logging.WARNING)
    propagate = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield logged
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
