"""Finds the stage at which connecting to an endpoint fails, and what to do about it.

Zenoh reports "Unable to connect" for all stages. This module opens one socket for each endpoint, only after an attempt
has failed: it must not delay a Stop.
"""

import datetime as dt
import re
import socket
import ssl
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from ipaddress import ip_address
from typing import Any, Final

import zenoh

from gateway import certs
from gateway.errors import ConfigError
from gateway.people.client.lease_requests import Identity
from gateway.words.own_command import DEFAULT_ENDPOINT, this_command
from gateway.zenoh.config import connect_endpoints, first_expiry
from gateway.zenoh.endpoints import is_local

TIMEOUT_S: Final = 1.0
"""The time for all endpoints together."""
_ALERT_S: Final = 0.3
"""Wait for the alert of a server that rejects a client's certificate: a round trip after the handshake."""
_ENDPOINT: Final = re.compile(
    r"(?P<link>tcp|tls)/(?P<host>\[[^\]]+\]|[^:#?\[\]]+):(?P<port>\d{1,5})(?:.*[#;]iface=(?P<iface>[^;]+)|[#?].*)?"
)
_OLDEST_YEAR: Final = 2024
"""No certificate of this project is older, so an earlier clock was never set."""

_SETS_CLOCK: Final = "timedatectl set-ntp true"
_CLOCK: Final = f"set the clock ({_SETS_CLOCK})"
_GIVE_CERTIFICATE: Final = "give --zenoh-config NAME.json5, which `hexapod-gateway certs issue` made"
_NEW_BUNDLE: Final = "unzip the bundle of `hexapod-gateway certs issue` again, all its files together"
_NO_TLS: Final = "does the gateway use certificates? Without them it is tcp/…, and on its own machine only"
_WRONG_HOST: Final = (62, 64)
_DISTRUSTED: Final = {
    9: ("is not valid yet", f"{_CLOCK} here"),
    10: ("has expired", f"{certs.renewal('gateway')}, and copy gateway.pem to the robot; or {_CLOCK} here"),
    26: (
        "is no robot's, such as a laptop's",
        "on the robot, with its folder of certificates: sudo hexapod-gateway setup --certs FOLDER",
    ),
} | dict.fromkeys(
    (2, 18, 19, 20, 21),
    ("is of another CA than yours", "is it the right robot? Take certificates from the folder that made the robot's"),
)
"""What is wrong with the robot's certificate, and its fix, by OpenSSL's X509_V_ERR_…"""
_ALERTS: Final = {
    "UNKNOWN_CA": (
        "the robot does not know the CA of your certificate",
        "get one from the folder that made the robot's (`hexapod-gateway certs issue`)",
    ),
    "EXPIRED": (
        "your certificate has expired, or is not valid yet, by the robot's clock",
        f"{certs.renewal('NAME')}; or set the robot's clock ({_SETS_CLOCK})",
    ),
    "CERTIFICATE_REQUIRED": ("the robot wants a certificate, and you show none", _GIVE_CERTIFICATE),
}
"""What is wrong with our certificate, and its fix, by a word in the reason of a robot's alert."""


class Stage(StrEnum):
    """The stages of connecting, in order."""

    ENDPOINT = "endpoint"
    NAME = "name"
    TCP = "TCP"
    TLS = "TLS"
    CERTIFICATE = "certificate"
    ROLE = "role"
    GATEWAY = "gateway"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one stage; `fix` is empty if it passed."""

    stage: Stage
    sentence: str
    fix: str = ""

    def __str__(self) -> str:
        return f"{self.stage}: {self.sentence}" + (f" → {self.fix}" if self.fix else "")


def why(config: zenoh.Config) -> list[str]:
    """Return a line for each endpoint, with the stage that fails, after TIMEOUT_S at most."""
    identity = Identity.of(config)
    found = diagnose_all(connect_endpoints(config), identity)
    if (of_clock := expired(identity)) is not None:
        return [f"no gateway answers: {of_clock}"]
    return [f"no gateway answers on {endpoint}: {findings[-1]}" for endpoint, findings in found.items()]


def diagnose_all(endpoints: Sequence[str], identity: Identity) -> dict[str, list[Finding]]:
    """Return the findings of `diagnose` for each endpoint, in parallel. The last is the stage that was reached."""
    end_s = time.monotonic() + TIMEOUT_S
    found: dict[str, list[Finding]] = {endpoint: [] for endpoint in endpoints}

    def find(endpoint: str) -> None:
        for finding in diagnose(endpoint, identity, end_s):
            found[endpoint].append(finding)  # one by one: the caller reads those before the end of its time

    # Daemons: the end of the program does not wait for them.
    threads = [threading.Thread(target=find, args=(each,), name=f"diagnose {each}", daemon=True) for each in found]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, end_s - time.monotonic()) + _MARGIN_S)
    late = Finding(Stage.NAME, "no name server answers within the time", "check the name; or dial its address")
    return {endpoint: list(findings) or [late] for endpoint, findings in found.items()}


_MARGIN_S: Final = 0.05
"""Extra time for a finding about a timeout."""


def diagnose(endpoint: str, identity: Identity, end_s: float) -> Iterator[Finding]:
    """Connect to `endpoint` stage by stage until one fails, at most until `end_s` (monotonic).

    Only the resolver may take longer: getaddrinfo has no timeout.
    """
    if (parsed := _ENDPOINT.fullmatch(endpoint)) is None:
        fix = f"dial it so, such as {DEFAULT_ENDPOINT}"
        yield Finding(Stage.ENDPOINT, "it is not tcp/HOST:PORT or tls/HOST:PORT", fix)
        return
    host, port, tls = parsed["host"].strip("[]"), int(parsed["port"]), parsed["link"] == "tls"
    if tls and ":" in host:
        fix = "dial the robot's name, or its IPv4 address"
        yield Finding(Stage.ENDPOINT, "Zenoh dials no IPv6 address over TLS", fix)
        return
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        addresses = [(family, _by_interface(at, parsed["iface"])) for family, *_, at in found]
    except (OSError, UnicodeError) as error:
        mdns = "is the robot on, and in this network? Names in .local need mDNS (avahi) here and there"
        fix = f"{mdns if host.endswith('.local') else 'check the name'}; or dial its address"
        yield Finding(Stage.NAME, f"{host} is unknown ({getattr(error, 'strerror', error)})", fix)
        return
    yield Finding(Stage.NAME, f"{host} is {', '.join(dict.fromkeys(str(address[0]) for _, address in addresses))}")
    try:
        connection = _connect(addresses, end_s)
    except OSError as error:
        if nowhere := next((str(at[0]) for _, at in addresses if _lacks_interface(at)), None):
            fix = f"dial {endpoint.partition('#')[0]}#iface=INTERFACE, as `ip link` names it"
            yield Finding(Stage.NAME, f"{host} is {nowhere}, which each network interface has for itself", fix)
        else:
            yield _unreachable(host, port, error, here=is_local(endpoint))
        return
    yield Finding(Stage.TCP, f"port {port} answers")
    with connection:
        yield from _tls(connection, host, identity, end_s) if tls else _plain(connection, end_s)


def _lacks_interface(at: Any) -> bool:
    """Return whether it is a link-local IPv6 address without an interface, to which Linux connects nowhere."""
    return len(at) == 4 and ip_address(at[0]).is_link_local and not at[3]


def _by_interface(at: Any, interface: str | None) -> Any:
    """Return the address with its interface. Raises OSError if there is no such interface."""
    return (*at[:3], socket.if_nametoindex(interface)) if interface and _lacks_interface(at) else at


def own_certificates(identity: Identity) -> Iterator[Finding]:
    """Yield the validity of this machine's certificates."""
    for path in (identity.ca, identity.certificate):
        if path is None:
            continue
        try:
            certificate = certs.files.read_certificate(path)
        except ConfigError as error:
            yield Finding(Stage.CERTIFICATE, str(error), "restore it from its bundle")
            continue
        now = dt.datetime.now(dt.UTC)
        yield validity(path.name, certificate.not_valid_before_utc, certificate.not_valid_after_utc, now)


def expired(identity: Identity) -> Finding | None:
    """Return the finding about a certificate of this machine that is not valid now, if there is one."""
    return next((each for each in own_certificates(identity) if each.fix), None)


def own_expiry(config: zenoh.Config) -> str | None:
    """Return a warning if one of this machine's certificates expires soon; None if none does or can be read."""
    with suppress(ConfigError):
        if (first := first_expiry(config)) is not None:
            return certs.expires_soon(first.file.name, first.end, dt.datetime.now(dt.UTC))
    return None


def validity(name: str, begin: dt.datetime, end: dt.datetime, now: dt.datetime) -> Finding:
    """Return the finding at `now` for a certificate that is valid from `begin` to `end`."""
    if now < begin:
        clock = f"this machine's clock states {now:%Y-%m-%d}"
        sentence = f"{name} is good from {begin:%Y-%m-%d} only, and {clock}"
        if now.year < _OLDEST_YEAR:
            sentence = f"{clock}, which is before any certificate was made"
        return Finding(Stage.CERTIFICATE, sentence, _CLOCK)
    if now >= end:
        fix = f"is this clock right? Then {certs.renewal('NAME')}"
        return Finding(Stage.CERTIFICATE, f"{name} expired on {end:%Y-%m-%d}", fix)
    return Finding(Stage.CERTIFICATE, f"{name} is good until {end:%Y-%m-%d}")


def _connect(addresses: Iterable[tuple[socket.AddressFamily, Any]], end_s: float) -> socket.socket:
    """Return a connection to the first address that accepts one. Raises the last address's error."""
    fault, left = OSError("no address"), len(list(addresses))
    for family, address in addresses:
        probe = socket.socket(family, socket.SOCK_STREAM)
        try:
            probe.settimeout(_left_s(end_s) / left)
            probe.connect(address)
        except OSError as error:
            probe.close()
            fault, left = error, left - 1
        else:
            return probe
    raise fault


def _unreachable(host: str, port: int, error: OSError, *, here: bool) -> Finding:
    if isinstance(error, ConnectionRefusedError):
        ports = "does the gateway run (systemctl status hexapod-gateway), and on this port?"
        far = "Without certificates it listens on its own machine only"
        other = f"Without a robot: {this_command()} run --sim" if here else far
        fix = f"{ports} {other}"
        return Finding(Stage.TCP, f"{host} rejects port {port}: nothing listens there", fix)
    if isinstance(error, TimeoutError):
        fix = "is the robot on, and in this network? A firewall may drop what comes for the port"
        return Finding(Stage.TCP, f"{host} does not answer on port {port}", fix)
    return Finding(Stage.TCP, f"{host} cannot be reached ({error.strerror})", "join the robot's network")


# ---- TLS


def _tls(connection: socket.socket, host: str, identity: Identity, end_s: float) -> Iterator[Finding]:
    try:
        context = ssl.create_default_context(cafile=None if identity.ca is None else str(identity.ca))
        context.check_hostname = identity.verify_name
        if identity.certificate is not None:
            context.load_cert_chain(str(identity.certificate), None if identity.key is None else str(identity.key))
    except (OSError, ssl.SSLError) as error:
        yield Finding(Stage.CERTIFICATE, f"the files of your certificate do not go together ({error})", _NEW_BUNDLE)
        return
    if identity.ca is None:
        yield Finding(Stage.CERTIFICATE, "the robot wants a certificate, and you have none", _GIVE_CERTIFICATE)
        return
    try:
        connection.settimeout(_left_s(end_s))
        with context.wrap_socket(connection, server_hostname=host) as secured:
            yield Finding(Stage.TLS, f"{host} shows a certificate of your CA, in its own name")
            yield _after_handshake(secured, end_s)
    except ssl.SSLCertVerificationError as error:
        yield _distrusted(host, error)
    except ssl.SSLError as error:
        yield _alert(error)
    except TimeoutError:
        yield Finding(Stage.TLS, "the port answers, but speaks no TLS within the time", _NO_TLS)
    except OSError:
        yield Finding(Stage.TLS, "the port ends the connection instead of speaking TLS", _NO_TLS)


def _after_handshake(secured: ssl.SSLSocket, end_s: float) -> Finding:
    """Return the finding about our certificate, by the robot's alert or its absence."""
    secured.settimeout(min(_ALERT_S, _left_s(end_s)))
    try:
        secured.recv(1)
    except TimeoutError:  # it waits for Zenoh's first message
        return Finding(Stage.CERTIFICATE, "the robot accepts yours")
    except ssl.SSLError as error:
        return _alert(error)
    except OSError:
        pass
    return Finding(Stage.GATEWAY, "the robot ends the connection", "is it at its most sessions? See its journal")


def _distrusted(host: str, error: ssl.SSLCertVerificationError) -> Finding:
    """Return the finding for a robot's certificate that we reject."""
    if error.verify_code in _WRONG_HOST:
        fix = f"dial it by a name that it has (hexapod-gateway certs list --dir DIR), or make it one with --host {host}"
        return Finding(Stage.TLS, f"the robot's certificate does not name {host}", fix)
    unknown = f"does not do ({error.verify_message})", _NEW_BUNDLE
    sentence, fix = _DISTRUSTED.get(error.verify_code, unknown)
    return Finding(Stage.CERTIFICATE, f"the robot's certificate {sentence}", fix)


def _alert(error: ssl.SSLError) -> Finding:
    """Return the finding for a robot that rejects our certificate, or uses no TLS."""
    reason = error.reason or ""
    if "ALERT" not in reason and not any(word in reason for word in _ALERTS):
        return Finding(Stage.TLS, f"the port speaks no TLS ({reason or error.strerror})", _NO_TLS)
    unknown = f"the robot does not take your certificate ({reason})", _NEW_BUNDLE
    sentence, fix = next((found for word, found in _ALERTS.items() if word in reason), unknown)
    return Finding(Stage.CERTIFICATE, sentence, fix)


def _plain(connection: socket.socket, end_s: float) -> Iterator[Finding]:
    """Yield a finding if a port that is dialled without TLS requires TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # only whether it speaks TLS matters
    connection.settimeout(min(_ALERT_S, _left_s(end_s)))
    try:
        with context.wrap_socket(connection):
            pass
    except (OSError, ssl.SSLError):
        fix = "another program may have the port (ss -ltnp there), or the gateway wants a password: see its journal"
        yield Finding(Stage.GATEWAY, "the port takes connections, but no gateway speaks there", fix)
        return
    yield Finding(Stage.TLS, "the port wants TLS, and you dial it without", f"dial tls/…, and {_GIVE_CERTIFICATE}")


def _left_s(end_s: float) -> float:
    return max(0.01, end_s - time.monotonic())
