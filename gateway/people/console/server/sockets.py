"""The console's listening sockets: systemd's, which outlive it, or its own.

While a console with its own socket is started again, its port is free, and any user of the machine may take it. A
socket unit keeps the port, and passes the sockets as file descriptors from 3 on (sd_listen_fds(3)).
"""

import errno
import os
import socket
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Final

from gateway.errors import AddressTakenError, ConfigError
from gateway.people.console.server.site import LOCALHOST, Site, address_of, share_no_port, with_port

BACKLOG: Final = 64
"""Connections that the kernel queues; it drops further ones."""
DEAD_MS: Final = 15_000
"""A connection that acknowledges nothing for this long is closed: its page is frozen, or its machine is gone."""
SOCKET_BUFFER_BYTES: Final = 8192
"""Of the kernel's buffer for each connection."""
FIRST_DESCRIPTOR: Final = 3
"""The first socket of systemd's (SD_LISTEN_FDS_START)."""
SOCKET_UNIT: Final = "hexapod-console.socket"


def inherited(environment: MutableMapping[str, str] = os.environ, first: int = FIRST_DESCRIPTOR) -> list[socket.socket]:
    """The listening TCP sockets that systemd has passed to this process. Raises ConfigError for other descriptors.

    The variables are removed, so no child process uses the sockets.
    """
    process, number, _ = (environment.pop(f"LISTEN_{name}", "") for name in ("PID", "FDS", "FDNAMES"))
    if process != str(os.getpid()):
        return []  # passed to a parent process
    if number not in ("1", "2"):
        raise ConfigError(f"LISTEN_FDS={number}: systemd passes one socket, or localhost's two; see {SOCKET_UNIT}")
    return [_checked(first + each) for each in range(int(number))]


def _checked(descriptor: int) -> socket.socket:
    with suppress(OSError):
        os.set_inheritable(descriptor, False)
        found = socket.socket(fileno=descriptor)
        if found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) and found.family in (
            socket.AF_INET,
            socket.AF_INET6,
        ):
            return found
        found.detach()
    raise ConfigError(
        f"LISTEN_FDS: descriptor {descriptor} is no TCP socket that listens (ListenStream=; see {SOCKET_UNIT})"
    )


def address_in(passed: Sequence[socket.socket], listen: str | None) -> str:
    """HOST:PORT of systemd's sockets. Raises ConfigError if `listen` (--listen) is another address.

    Only the unit states the address: if the console listened elsewhere, nobody would serve the unit's port.
    """
    places = [each.getsockname()[:2] for each in passed]
    hosts, ports = [str(host) for host, _ in places], {int(port) for _, port in places}
    if len(hosts) == len(LOCALHOST) and (set(hosts) != set(LOCALHOST) or len(ports) != 1):
        raise ConfigError(f"{SOCKET_UNIT} has two addresses; only 127.0.0.1 and [::1] with one port belong together")
    host, port = "localhost" if len(hosts) > 1 else hosts[0], ports.pop()
    if listen is not None and address_of(listen) != (host, port):
        raise ConfigError(
            f"--listen {listen} is not where {SOCKET_UNIT} listens ({with_port(host, port)}): remove --listen from "
            f"/etc/hexapod-console/console.conf, and name the address there: sudo systemctl edit {SOCKET_UNIT}"
        )
    return with_port(host, port)


@contextmanager
def listening(site: Site, passed: Sequence[socket.socket] = ()) -> Iterator[Sequence[socket.socket]]:
    """`passed`, or sockets bound here; for `localhost` on all of its addresses, so no other program has one of them."""
    with ExitStack() as stack:
        for own in passed:
            _prepare(stack.enter_context(own))
        hosts = LOCALHOST if site.address == "localhost" else (site.address,)
        found = passed or [each for host in hosts if (each := _bound(stack, site, host)) is not None]
        if not found:
            raise ConfigError(f"--listen {with_port(site.address, site.port)}: this machine has no such address")
        yield found


def _prepare(listening: socket.socket) -> None:
    """Set what its connections inherit, and listen."""
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER_BYTES)
    listening.listen(BACKLOG)


def _bound(stack: ExitStack, site: Site, address: str) -> socket.socket | None:
    """None if this machine lacks this address of localhost's, such as without IPv6. Raises ConfigError."""
    where = with_port(address, site.port)
    try:
        family, _, _, _, place = socket.getaddrinfo(address, site.port, type=socket.SOCK_STREAM)[0]
        listening = stack.enter_context(socket.socket(family, socket.SOCK_STREAM))
        share_no_port(listening)
        listening.bind(place)
        _prepare(listening)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise AddressTakenError(
                f"{where} is taken by another program (perhaps another console); stop it, or set another --listen"
            ) from error
        if site.address == "localhost" and error.errno in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
            return None
        raise ConfigError(f"--listen {where}: {error.strerror}; name an address of this machine") from error
    return listening
