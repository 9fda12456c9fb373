"""The console's address: the Host and Origin headers that belong to it, and the sockets that listen there.

Neither a page of another origin nor a foreign name that points at this machine (DNS rebinding) may reach the robot with
the cookie of a session. So both headers are compared with the console's own address.
"""

import errno
import os
import shlex
import socket
import ssl
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Final

from gateway.errors import AddressTakenError, ConfigError
from gateway.host.directories import CONSOLE_STATE
from gateway.own_command import this_command

LOCALHOST: Final = ("127.0.0.1", "::1")
"""Browsers resolve `localhost` to these, independent of the hosts file. Links name the first."""
BACKLOG: Final = 64
"""Connections that the kernel queues; it drops further ones."""
UNSENT_BYTES: Final = 4096
"""Most bytes that wait for one page, in this process and again in the kernel: some five states."""
RECEIVED_BYTES: Final = 8192
"""Most bytes that the kernel keeps of each connection, until this process reads them."""


@dataclass(frozen=True)
class Site:
    """One listening address. `hosts`: the names by which browsers reach it; links have the first."""

    address: str
    port: int
    hosts: tuple[str, ...]
    tls: ssl.SSLContext | None = None

    @property
    def scheme(self) -> str:
        """`https` with a certificate, else `http`."""
        return "https" if self.tls else "http"

    @property
    def url(self) -> str:
        """Its address in a browser, without a path: `http://127.0.0.1:8080`."""
        return f"{self.scheme}://{with_port(self.hosts[0], self.port)}"

    @property
    def cookie(self) -> str:
        """The session cookie's name, with the port: browsers send a cookie to all ports, also of other consoles."""
        host = "__Host-" if self.tls else ""  # no other host can set it
        return f"{host}hexapod-console-{self.port}"

    @property
    def link_command(self) -> str:
        """The command that prints a link for another browser, on the console's machine; of the service, as root."""
        sudo = "sudo " if os.environ.get("STATE_DIRECTORY") == str(CONSOLE_STATE) else ""
        return f"{sudo}{this_command()} console --link --listen {shlex.quote(with_port(self.address, self.port))}"

    def knows_host(self, host: str | None) -> bool:
        """Return whether a Host header names this site."""
        own = [with_port(each, self.port) for each in self.hosts]
        if self.port == (443 if self.tls else 80):  # browsers leave it out
            own += [each.rpartition(":")[0] for each in own]
        return host is not None and host.lower() in own


def with_port(host: str, port: int) -> str:
    """Return `HOST:PORT`, with an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


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
