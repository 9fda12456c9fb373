"""Keeps sessions free for operators: other clients (visitors) get a share of Zenoh's sessions, revoked clients none.

Zenoh limits only the sum of all sessions, and its API cannot close one. So this shuts down the sockets of the newest
visitors beyond their share; Zenoh drops such a session within a millisecond. Older sessions stay. Without client
certificates, clients cannot be distinguished, and none is shut down.

TLS accepts every certificate of the CA, even a revoked one. Access control drops a revoked client's messages; shutting
down its socket also frees its place.
"""

import ipaddress
import logging
import os
import socket
import stat
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any, Final

import zenoh

from gateway.certs import BUTTON, OPERATOR
from gateway.certs.access import role_of
from gateway.host.worker import Worker
from gateway.rate_limit import RateLimit
from gateway.zenoh.endpoints import host_and_port
from gateway.zenoh.limits import MAX_SESSIONS, OPERATORS_PLACES

VISITORS: Final = MAX_SESSIONS - OPERATORS_PLACES
SAY_AGAIN_S: Final = 10.0
"""Shortest time between two warnings. Rejected clients reconnect several times a second."""

logger = logging.getLogger(__name__)


class ConnectionLimiter:
    """Counts the visitors each time a link opens or closes, on a thread of its own."""

    def __init__(self, session: zenoh.Session, count: Callable[[int], None], revoked: Collection[str]) -> None:
        """`count` is called with the number of sessions after each change. `revoked` are common names to shut out."""
        self._revoked = revoked
        self._session = session
        self._count = count
        self._sessions: list[str] = []
        """The Zenoh ids, in the order of their arrival."""
        self._warnings = RateLimit(1 / SAY_AGAIN_S, 1)
        self._worker = Worker("connection_limiter")
        # No ring: Zenoh's `recv` wakes ten times a second.
        self._listener = session.info.declare_link_events_listener(self._changed, history=True)

    def close(self) -> None:
        """End the thread. Blocks, so do not call it on the loop's thread."""
        with suppress(zenoh.ZError):
            self._listener.undeclare()
        self._worker.close()

    def _changed(self, _: object) -> None:
        """Check the links soon. One check that has not begun is enough, since it reads all links."""
        if not self._worker.waiting:
            self._worker.do(self._check_links)

    def _check_links(self) -> None:
        try:
            links = self._session.info.links()
        except zenoh.ZError:  # the session is closed
            return
        present = [str(link.zid) for link in links]
        self._sessions = [zid for zid in dict.fromkeys([*self._sessions, *present]) if zid in present]
        self._count(len(self._sessions))
        shut_out = [link for link in links if link.auth_identifier in self._revoked]
        named = [link for link in links if link.auth_identifier and link.auth_identifier not in self._revoked]
        visitors = [link for link in named if role_of(str(link.auth_identifier)) not in (OPERATOR, BUTTON)]
        surplus = sorted(visitors, key=lambda link: self._sessions.index(str(link.zid)))[VISITORS:]
        if not surplus and not shut_out:
            return
        with suppress(OSError):  # no descriptor is left to list them
            shut_down({_address(str(link.dst)) for link in surplus + shut_out} - {None})
        if not self._warnings.take(time.monotonic_ns()):
            return
        if shut_out:
            names = sorted({str(link.auth_identifier) for link in shut_out})
            logger.warning("rejected connections with revoked certificates: %s", ", ".join(names))
        if surplus:
            logger.warning(
                "%d clients without the operator role are connected; those beyond %d are disconnected, to keep places "
                "for operators",
                len(visitors),
                VISITORS,
            )


def shut_down(addresses: Collection[Any]) -> None:
    """Shut down this process's connections to these peers, each an IP address and a port.

    Zenoh owns the descriptors, so all descriptors of the process are searched. Raises OSError if none is left to list
    them.
    """
    for number in map(int, os.listdir("/proc/self/fd")):
        with suppress(OSError):
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                continue
            # A duplicate, since Zenoh may close the descriptor meanwhile and its number be reused. Without a descriptor
            # for the duplicate, no new client can connect either. An address of IPv4 fits where one of IPv6 does.
            with socket.fromfd(number, socket.AF_INET6, socket.SOCK_STREAM) as connection:
                peer = connection.getpeername()  # a text for a Unix socket
                if isinstance(peer, tuple) and _address(f"tcp/{peer[0]}:{peer[1]}") in addresses:
                    connection.shutdown(socket.SHUT_RDWR)


def _address(locator: str) -> Any:
    """Return address and port of a locator such as `tls/[::ffff:192.0.2.7]:49090`, or None if it has none."""
    host, port = host_and_port(locator)
    with suppress(ValueError):
        return ipaddress.ip_address(host.partition("%")[0]), int(port)
    return None
