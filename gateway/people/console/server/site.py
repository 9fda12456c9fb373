"""The console's address: where it listens, by its arguments or its socket unit, and which Host headers are its own.

Neither a page of another origin nor a foreign name that points at this machine (DNS rebinding) may reach the robot with
the cookie of a session. So both headers are compared with the console's own address.

While a console with its own socket is started again, its port is free, and any user of the machine may take it. A
socket unit keeps the port, and passes the sockets as file descriptors from 3 on (sd_listen_fds(3)).
"""

import errno
import os
import re
import shlex
import socket
import ssl
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from gateway.certs.authority import hosts_of
from gateway.certs.files import read_certificate
from gateway.errors import AddressTakenError, ConfigError
from gateway.host.directories import CONSOLE_STATE
from gateway.words.own_command import this_command
from gateway.zenoh.endpoints import is_local

_HOST: Final = re.compile(r"(?P<name>[\w.-]+|\[[\da-f:.]+])(?::(?P<port>\d{1,5}))?", re.ASCII | re.IGNORECASE)
LOCALHOST: Final = ("127.0.0.1", "::1")
"""Browsers resolve `localhost` to these, independent of the hosts file. Links name the first."""
_LOOPBACK: Final = (*LOCALHOST, "localhost")
BACKLOG: Final = 64
"""Connections that the kernel queues; it drops further ones."""
UNSENT_BYTES: Final = 4096
"""Most bytes that wait for one page, in this process and again in the kernel: some five states."""
RECEIVED_BYTES: Final = 8192
"""Most bytes that the kernel keeps of each connection, until this process reads them."""


@dataclass(frozen=True)
class Site:
    """One listening address. `hosts`: the names by which browsers reach it; links have the first.

    `admitted`: names of a proxy or a tunnel in front of it, at any port, also with TLS that ends there.
    """

    address: str
    port: int
    hosts: tuple[str, ...]
    tls: ssl.SSLContext | None = None
    admitted: tuple[str, ...] = ()

    @property
    def scheme(self) -> str:
        """`https` with a certificate, else `http`."""
        return "https" if self.tls else "http"

    @property
    def url(self) -> str:
        """Its address in a browser, without a path: `http://127.0.0.1:8080`."""
        return f"{self.scheme}://{with_port(self.hosts[0], self.port)}"

    def cookie_at(self, host: str | None) -> str:
        """Return the session cookie's name, with the browser's port: browsers send a cookie to all ports of a host."""
        only = "__Host-" if self.tls else ""  # no other host can set it
        return f"{only}hexapod-console-{_split(host or '')[1] or self.port}"

    @property
    def link_command(self) -> str:
        """The command that prints a link for another browser, on the console's machine; of the service, as root."""
        return ("sudo " if _is_service() else "") + self._command("--link ")

    @property
    def start_command(self) -> str:
        """The command that starts it again, on the console's machine."""
        return "sudo systemctl restart hexapod-console" if _is_service() else self._command()

    def _command(self, option: str = "") -> str:
        return f"{this_command()} console {option}--listen {shlex.quote(with_port(self.address, self.port))}"

    def knows_host(self, host: str | None) -> bool:
        """Return whether a Host header names this site. A tunnel leads to it from loopback at any port.

        No other machine's name can point at loopback, so its names are safe from DNS rebinding at any port. With TLS,
        loopback counts only if the certificate names it.
        """
        own = [with_port(each, self.port) for each in self.hosts]
        if self.port == (443 if self.tls else 80):  # browsers leave it out
            own += [each.rpartition(":")[0] for each in own]
        local = [each for each in _LOOPBACK if self.tls is None or each in self.hosts]
        name, port = _split((host or "").lower())
        return host is not None and (
            host.lower() in own or name in self.admitted or (port != "" and name.strip("[]") in local)
        )

    def is_own(self, origin: str | None, host: str | None) -> bool:
        """Return whether an Origin header is of a page of this site, as reached by this Host."""
        schemes = (self.scheme, "https") if _split((host or "").lower())[0] in self.admitted else (self.scheme,)
        return origin in [f"{scheme}://{host}" for scheme in schemes]


def _is_service() -> bool:
    return os.environ.get("STATE_DIRECTORY") == str(CONSOLE_STATE)


def with_port(host: str, port: int) -> str:
    """Return `HOST:PORT`, with an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _split(host: str) -> tuple[str, str]:
    """Return a Host header's name, an IPv6 address in brackets, and its port; "": it has none."""
    found = _HOST.fullmatch(host)
    return (found["name"], found["port"] or "") if found else ("", "")


@contextmanager
def listening(site: Site, passed: Sequence[socket.socket] = ()) -> Iterator[Sequence[socket.socket]]:
    """`passed`, or sockets bound here; for `localhost` on all of its addresses, so no other program has one of them.

    Raises ConfigError, AddressTakenError.
    """
    with ExitStack() as stack:
        found = [stack.enter_context(each) for each in passed]
        for host in () if passed else LOCALHOST if site.address == "localhost" else (site.address,):
            where = with_port(host, site.port)
            try:
                found.append(stack.enter_context(bound(host, site.port)))
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    raise AddressTakenError(
                        f"{where} is taken by another program (perhaps another console); "
                        "stop it, or set another --listen"
                    ) from error
                if site.address != "localhost" or error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                    raise ConfigError(f"--listen {where}: {error.strerror}; name an address of this machine") from error
        if not found:
            raise ConfigError(f"--listen {with_port(site.address, site.port)}: this machine has no such address")
        for each in found:  # its connections inherit this
            each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVED_BYTES)
            if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # not on Windows
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
        yield found


def bound(address: str, port: int) -> socket.socket:
    """Return a socket that listens at this address. Raises OSError, also if another program listens there."""
    family, _, _, _, place = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)[0]
    both = family == socket.AF_INET6 and socket.has_dualstack_ipv6()
    return socket.create_server(place[:2], family=family, backlog=BACKLOG, dualstack_ipv6=both)


CONSOLE_PORT: Final = 8080
DEFAULT_ADDRESS: Final = "127.0.0.1"
SOCKET_UNIT: Final = "hexapod-console.socket"
_NEXT_PORTS: Final = range(CONSOLE_PORT + 1, CONSOLE_PORT + 20)
"""Tried if no address is given and another program has the default port."""


def site(listen: str, certificate: Path | None, key: Path | None, admitted: Sequence[str] = ()) -> Site:
    """Return the site at `listen`. Raises ConfigError, with a fix, if it is no address or needs TLS."""
    address, port = address_of(listen)
    for each in admitted:
        if not each or _split(each) != (each, ""):
            raise ConfigError(
                f"--host {each} is no name of a host, such as robot.example: leave out scheme, port and path"
            )
    names = tuple(each.lower() for each in admitted)
    if (certificate is None) != (key is None):
        raise ConfigError("--cert and --key go together: the certificate and its private key (PEM)")
    if certificate is None or key is None:
        if not is_local(f"tcp/{with_port(address, port)}"):
            raise ConfigError(
                f"{listen} is reached from other machines, so the console needs TLS: --phone, or --cert and --key\n"
                "where ca.key is, hexapod-gateway certs issue web --role console --host NAME --dir DIR makes both\n"
                "or keep it on this machine (--listen 127.0.0.1:8080), and reach it through ssh -L 8080:127.0.0.1:8080"
            )
        hosts = _LOOPBACK if address == "localhost" else tuple(dict.fromkeys((address, "localhost")))
        return Site(address, port, hosts, admitted=names)
    certified = hosts_of(read_certificate(certificate))
    if not certified:
        raise ConfigError(
            f"{certificate} names no host, so no browser accepts it: "
            "make one with hexapod-gateway certs issue web --role console --host NAME --dir DIR"
        )
    own = (address,) if address.lower() in certified else ()
    return Site(address, port, tuple(dict.fromkeys((*own, *certified))), _tls(certificate, key), names)


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


def free_address(address: str = DEFAULT_ADDRESS) -> str:
    """Return `HOST:PORT` with the first free port, or with the default port if none is free."""
    for port in (CONSOLE_PORT, *_NEXT_PORTS):
        with suppress(OSError), bound(address, port):
            return with_port(address, port)
    return with_port(address, CONSOLE_PORT)


def inherited(environment: MutableMapping[str, str] = os.environ, first: int = 3) -> list[socket.socket]:
    """Return the listening TCP sockets that systemd has passed to this process. Raises ConfigError for others.

    The variables are removed, so no child process uses the sockets.
    """
    process, number, _ = (environment.pop(f"LISTEN_{name}", "") for name in ("PID", "FDS", "FDNAMES"))
    if process != str(os.getpid()):
        return []  # passed to a parent process
    return [_checked(first + each) for each in range(int(number))]


def address_in(passed: Sequence[socket.socket], listen: str | None) -> str:
    """HOST:PORT of systemd's sockets. Raises ConfigError if `listen` (--listen) is another address.

    Only the unit states the address: if the console listened elsewhere, nobody would serve the unit's port.
    """
    hosts, ports = ({each.getsockname()[part] for each in passed} for part in (0, 1))
    if len(passed) > 1 and (hosts != set(LOCALHOST) or len(ports) > 1):
        raise ConfigError(
            f"{SOCKET_UNIT} has {len(passed)} addresses; only 127.0.0.1 and [::1] with one port may be two"
        )
    host, port = "localhost" if len(hosts) > 1 else hosts.pop(), ports.pop()
    if listen is not None and address_of(listen) != (host, port):
        raise ConfigError(
            f"--listen {listen} is not where {SOCKET_UNIT} listens ({with_port(host, port)}): remove --listen from "
            f"/etc/hexapod-console/console.conf, and name the address there: sudo systemctl edit {SOCKET_UNIT}"
        )
    return with_port(host, port)


def _checked(descriptor: int) -> socket.socket:
    with suppress(OSError):
        os.set_inheritable(descriptor, False)
        found = socket.socket(fileno=descriptor)
        listens = found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
        if listens and found.family in (socket.AF_INET, socket.AF_INET6):
            return found
        found.detach()
    raise ConfigError(
        f"LISTEN_FDS: descriptor {descriptor} is no TCP socket that listens (ListenStream=; see {SOCKET_UNIT})"
    )


def _tls(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS 1.2 or newer. Raises ConfigError."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION  # in TLS 1.2 a client could demand handshakes without end
    try:
        context.load_cert_chain(certificate, key, password=_no_password)
    except (OSError, ssl.SSLError, ValueError) as error:
        why = getattr(error, "reason", None) or getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"{certificate} and {key} cannot be used together: {why}") from error
    return context


def _no_password() -> str:
    raise ValueError("the key has a password; a service cannot type it")
