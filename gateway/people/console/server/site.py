"""The console's address, and the Host and Origin headers that belong to it.

Neither a page of another origin nor a foreign name that points at this machine (DNS rebinding) may reach the robot with
the cookie of a session. So both headers are compared with the console's own address.
"""

import ipaddress
import os
import shlex
import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from gateway.certs.authority import hosts_of
from gateway.certs.files import read_certificate
from gateway.errors import ConfigError
from gateway.own_command import this_command

CONSOLE_PORT: Final = 8080
STATE_DIRECTORY: Final = Path("/var/lib/hexapod-console")
"""The folder of the service hexapod-console, also for root's commands."""
DEFAULT_ADDRESS: Final = "127.0.0.1"
LOCALHOST: Final = ("127.0.0.1", "::1")
"""Browsers resolve `localhost` to these, independent of the hosts file. Links name the first."""
_NEXT_PORTS: Final = range(CONSOLE_PORT + 1, CONSOLE_PORT + 20)
"""Tried if no address is given and another program has the default port."""
_DEFAULT_PORTS: Final = {"http": 80, "https": 443}


@dataclass(frozen=True)
class Site:
    """One listening address. `hosts`: the names by which browsers reach it; links have the first."""

    address: str
    port: int
    hosts: tuple[str, ...]
    certificate: Path | None = None
    key: Path | None = None

    @property
    def scheme(self) -> str:
        """`https` with a certificate, else `http`."""
        return "http" if self.certificate is None else "https"

    @property
    def url(self) -> str:
        """Its address in a browser, without a path: `http://127.0.0.1:8080`."""
        return f"{self.scheme}://{self._authority(self.hosts[0])}"

    @property
    def cookie(self) -> str:
        """The session cookie's name, with the port: browsers send a cookie to all ports, and another console may run.

        With TLS no other host can set it (`__Host-`).
        """
        return f"{'__Host-' if self.certificate else ''}hexapod-console-{self.port}"

    @property
    def link_command(self) -> str:
        """The command that prints a link for another browser, on the console's machine; of the service, as root."""
        sudo = "sudo " if os.environ.get("STATE_DIRECTORY") == str(STATE_DIRECTORY) else ""
        return f"{sudo}{this_command()} console --link --listen {shlex.quote(with_port(self.address, self.port))}"

    def knows_host(self, host: str | None) -> bool:
        """Return whether a Host header names this site."""
        return host is not None and host.lower() in self._authorities()

    def knows_origin(self, origin: str | None, host: str | None) -> bool:
        """Return whether an Origin header is this site's own, reached by that Host."""
        return origin is not None and host is not None and self.knows_host(host) and origin == f"{self.scheme}://{host}"

    def _authorities(self) -> set[str]:
        return {self._authority(host) for host in self.hosts} | {with_port(host, self.port) for host in self.hosts}

    def _authority(self, host: str) -> str:
        full = with_port(host, self.port)
        return full.removesuffix(f":{self.port}") if self.port == _DEFAULT_PORTS[self.scheme] else full


def site(listen: str, certificate: Path | None, key: Path | None) -> Site:
    """Return the site at `listen`. Raises ConfigError, with a fix, if it is no address or needs TLS."""
    address, port = address_of(listen)
    if (certificate is None) != (key is None):
        raise ConfigError("--cert and --key go together: the certificate and its private key (PEM)")
    if certificate is None or key is None:
        if not _is_loopback(address):
            raise ConfigError(
                f"{listen} is reached from other machines, so the console needs TLS: --phone, or --cert and --key\n"
                "where ca.key is, hexapod-gateway certs issue web --role console --host NAME --dir DIR makes both\n"
                "or keep it on this machine (--listen 127.0.0.1:8080), and reach it through ssh -L 8080:127.0.0.1:8080"
            )
        hosts = (*LOCALHOST, "localhost") if address == "localhost" else tuple(dict.fromkeys((address, "localhost")))
        return Site(address, port, hosts)
    names = hosts_of(read_certificate(certificate))
    if not names:
        raise ConfigError(
            f"{certificate} names no host, so no browser accepts it: "
            "make one with hexapod-gateway certs issue web --role console --host NAME --dir DIR"
        )
    _check_pair(certificate, key)
    own = (address,) if address.lower() in names else ()
    return Site(address, port, tuple(dict.fromkeys((*own, *names))), certificate, key)


def address_of(listen: str) -> tuple[str, int]:
    """Split `HOST:PORT`; the default port is 8080. Raises ConfigError if it is no address."""
    try:
        parts = urlsplit(f"//{listen}")
        host, port = parts.hostname, CONSOLE_PORT if parts.port is None else parts.port
    except ValueError:
        host, port = None, 0
    if not host or parts.path or parts.query or "@" in listen or not 1 <= port <= 65535:
        raise ConfigError(f"--listen {listen} is no HOST:PORT, such as 127.0.0.1:8080")
    return host, port


def with_port(host: str, port: int) -> str:
    """Return `HOST:PORT`, with an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def free_address(address: str = DEFAULT_ADDRESS) -> str:
    """Return `HOST:PORT` with the first free port, or with the default port if none is free."""
    ports = (port for port in (CONSOLE_PORT, *_NEXT_PORTS) if _is_free(address, port))
    return with_port(address, next(ports, CONSOLE_PORT))


def _is_free(address: str, port: int) -> bool:
    with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as probe, suppress(OSError):
        share_no_port(probe)  # as the console itself
        probe.bind((address, port))
        probe.listen()
        return True
    return False


def share_no_port(own: socket.socket) -> None:
    """Bind at once after an earlier console, but never beside one: SO_REUSEADDR would allow that on Windows."""
    exclusive = getattr(socket, "SO_EXCLUSIVEADDRUSE", None)
    own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR if exclusive is None else exclusive, 1)


def _is_loopback(address: str) -> bool:
    with suppress(ValueError):
        return address == "localhost" or ipaddress.ip_address(address).is_loopback
    return False


def _check_pair(certificate: Path, key: Path) -> None:
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=_no_password)
    except (OSError, ssl.SSLError, ValueError) as error:
        why = getattr(error, "reason", None) or getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"{certificate} and {key} cannot be used together: {why}") from error


def _no_password() -> str:
    raise ValueError("the key has a password; a service cannot type it")
