"""The sockets on which the console listens: systemd's, which outlive it, or its own.

While a console that binds by itself is started again, its port is free, and any user of the machine may take it. A
socket unit keeps the port: the console finds the socket from file descriptor 3 on (sd_listen_fds(3)).
"""

import errno
import os
import socket
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final

from gateway.errors import AddressTakenError, ConfigError
from gateway.people.console.site import LOCALHOST, Site, address_of

BACKLOG: Final = 64
"""Connections that the kernel keeps until they are taken; it drops more."""
DEAD_MS: Final = 15_000
"""A connection that takes nothing for so long is given up: a page that is frozen, or whose machine is gone."""
RECEIVE_BYTES: Final = 8192
"""Of the kernel's buffer for each connection."""
FIRST_DESCRIPTOR: Final = 3
"""Where systemd puts the first socket (SD_LISTEN_FDS_START)."""
UNIT: Final = "hexapod-console.socket"


def inherited(environment: MutableMapping[str, str] = os.environ, first: int = FIRST_DESCRIPTOR) -> list[socket.socket]:
    """The listening TCP sockets that systemd has passed to this process; empty: none. Raises ConfigError for others.

    The variables are removed, so that no child takes the sockets for its own.
    """
    process, number, _ = (environment.pop(f"LISTEN_{name}", "") for name in ("PID", "FDS", "FDNAMES"))
    if process != str(os.getpid()):
        return []  # passed to a parent, which left its environment to this process
    if number not in map(str, range(1, len(LOCALHOST) + 1)):
        raise ConfigError(f"LISTEN_FDS={number}: systemd passes one socket, or localhost's two; see {UNIT}")
    descriptors = range(first, first + int(number))
    return [_checked(each) for each in descriptors]


def _checked(descriptor: int) -> socket.socket:
    try:
        os.set_inheritable(descriptor, False)
        found = socket.socket(fileno=descriptor)
        listens = found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
    except OSError as error:
        raise ConfigError(f"LISTEN_FDS: descriptor {descriptor} is no socket: {error.strerror}; see {UNIT}") from error
    if found.family not in (socket.AF_INET, socket.AF_INET6) or found.type != socket.SOCK_STREAM or not listens:
        found.detach()
        raise ConfigError(
            f"LISTEN_FDS: descriptor {descriptor} is no TCP socket that listens (ListenStream=; see {UNIT})"
        )
    return found


def address_in(passed: Sequence[socket.socket], listen: str | None) -> str:
    """HOST:PORT of systemd's sockets. Raises ConfigError where `listen` (--listen) is another address.

    The unit alone has the address: a console that listened elsewhere would leave the unit's port to nobody.
    """
    places = [each.getsockname()[:2] for each in passed]
    hosts, ports = [str(host) for host, _ in places], {int(port) for _, port in places}
    if len(hosts) == len(LOCALHOST) and (set(hosts) != set(LOCALHOST) or len(ports) != 1):
        raise ConfigError(f"{UNIT} has two addresses; only 127.0.0.1 and [::1] with one port belong together")
    host, port = "localhost" if len(hosts) > 1 else hosts[0], ports.pop()
    if listen is not None and address_of(listen) != (host, port):
        raise ConfigError(
            f"--listen {listen} is not where {UNIT} listens ({_written(host, port)}): remove --listen from "
            f"/etc/hexapod-console/console.conf, and name the address there: sudo systemctl edit {UNIT}"
        )
    return _written(host, port)


@contextmanager
def listening(site: Site, passed: Sequence[socket.socket] = ()) -> Iterator[Sequence[socket.socket]]:
    """On `passed`, or bound here: at `localhost` at all of its addresses, so that nobody else has one of them."""
    with ExitStack() as stack:
        for own in passed:
            _prepare(stack.enter_context(own))
        hosts = LOCALHOST if site.address == "localhost" else (site.address,)
        found = passed or [each for host in hosts if (each := _bound(stack, site, host)) is not None]
        if not found:
            raise ConfigError(f"--listen {_written(site.address, site.port)}: this machine has no such address")
        yield found


def _prepare(listening: socket.socket) -> None:
    """Connections inherit these."""
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
    listening.listen(BACKLOG)


def _bound(stack: ExitStack, site: Site, address: str) -> socket.socket | None:
    """None where this machine has no such address of localhost's, such as without IPv6."""
    try:
        family, kind, _, _, place = socket.getaddrinfo(
            address, site.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise ConfigError(f"--listen: {address} is no address of this machine: {error.strerror}") from error
    try:
        listening = stack.enter_context(socket.socket(family, kind))
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(place)
        _prepare(listening)
    except OSError as error:
        where = _written(address, site.port)
        if error.errno == errno.EADDRINUSE:
            raise AddressTakenError(
                f"{where} is taken by another program (perhaps another console); stop it, or set another --listen"
            ) from error
        if site.address == "localhost" and error.errno in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
            return None
        raise ConfigError(f"--listen {where}: {error.strerror}; name an address of this machine") from error
    return listening


def _written(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
