"""Keeps sessions free for operators: clients without that role (visitors) get only a share of those that Zenoh allows,
and whoever is revoked gets none.

Nothing simpler does: Zenoh limits all sessions together, not those of a role or a listener, and its API cannot close
one. So the newest visitors beyond their share lose their connection: their socket is shut down, and Zenoh drops the
session within a millisecond. Older sessions stay. Without client certificates nobody can be told apart, and nothing is
done.

TLS lets in whoever has a certificate of the CA. Access control lets nothing of the revoked through; their sockets are
shut down besides, so that they take no place.
"""

import ipaddress
import logging
import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

import zenoh
from zenoh.handlers import RingChannel

from gateway.allowance import Allowance
from gateway.certs import BUTTON, OPERATOR, pool
from gateway.limits import MAX_SESSIONS, OPERATORS_PLACES
from gateway.robot.host.realtime import PAGE_PRIORITY, prefer_thread

VISITORS: Final = MAX_SESSIONS - OPERATORS_PLACES
SAY_AGAIN_S: Final = 10.0
"""Shortest time between two warnings: clients that were turned away try again several times a second."""

logger = logging.getLogger(__name__)


class ConnectionLimiter:
    """Counts the visitors whenever a link opens or closes, on a thread of its own."""

    def __init__(
        self,
        session: zenoh.Session,
        count: Callable[[int], None],
        revoked: Collection[str] = frozenset(),
        note: Callable[[Collection[str]], None] = lambda _: None,
    ) -> None:
        """`count` is called with the number of sessions whenever it may have changed.

        `revoked`: the common names that are shut out. `note` is called with those that are connected.
        """
        self._revoked = revoked
        self._note = note
        self._session = session
        self._count = count
        self._since: dict[str, int] = {}
        self._visits = 0
        self._warnings = Allowance(1 / SAY_AGAIN_S, 1)
        # One event in the ring is enough: each look reads all links.
        self._listener = session.info.declare_link_events_listener(RingChannel(1), history=True)
        self.thread = threading.Thread(target=self._run, name="connection_limiter", daemon=True)
        self.thread.start()

    def close(self) -> None:
        """End the thread. Blocks; not for the loop's thread."""
        with suppress(zenoh.ZError):
            self._listener.undeclare()
        self.thread.join()

    def _run(self) -> None:
        prefer_thread(PAGE_PRIORITY)
        events = self._listener.handler
        with suppress(zenoh.ZError):  # the ring closes with the session
            while True:
                events.recv()
                self._look()

    def _look(self) -> None:
        links = self._session.info.links()
        self._since = {str(link.zid): self._arrival(str(link.zid)) for link in links}
        self._count(len(self._since))
        self._note({name for link in links if (name := link.auth_identifier)})
        shut_out = [link for link in links if link.auth_identifier in self._revoked]
        visitors = [
            link
            for link in links
            if (name := link.auth_identifier) and name not in self._revoked and not is_operator(name)
        ]
        surplus = sorted(visitors, key=lambda link: self._since[str(link.zid)])[VISITORS:]
        if not surplus and not shut_out:
            return
        with suppress(OSError):  # no descriptor left to look
            shut_down({address for link in surplus + shut_out if (address := _address(str(link.dst))) is not None})
        if not self._warnings.take(time.monotonic_ns()):
            return
        if shut_out:
            names = sorted({str(link.auth_identifier) for link in shut_out})
            logger.warning("%s is revoked, tries to connect, and is turned away", ", ".join(names))
        if surplus:
            logger.warning(
                "%d clients that are no operators are connected; those beyond %d are turned away, so that an operator "
                "finds a place",
                len(visitors),
                VISITORS,
            )

    def _arrival(self, zid: str) -> int:
        self._visits += 1
        return self._since.get(zid, self._visits)


def is_operator(identity: str) -> bool:
    """Whether a certificate's common name is that of somebody who may stop: `operator-07`, `button-07`.

    In a fleet `operator-07.ROBOT`.
    """
    return pool.holder(identity).role in (OPERATOR, BUTTON)


def shut_down(addresses: Collection[Any]) -> None:
    """Shut down this process's connections to these addresses, as Zenoh's own descriptors hold them."""
    for number in map(int, os.listdir("/proc/self/fd")):
        # Zenoh may close the descriptor meanwhile, and its number be used again; a duplicate keeps the connection.
        # With no descriptor left for a duplicate, nothing is done; then no new client can connect either.
        with suppress(OSError), _duplicate(number) as connection:
            if _peer(connection) in addresses:
                connection.shutdown(socket.SHUT_RDWR)


@contextmanager
def _duplicate(number: int) -> Iterator[socket.socket]:
    if not stat.S_ISSOCK(os.fstat(number).st_mode):
        raise OSError(f"{number} is no socket")
    copy = os.dup(number)
    try:
        connection = socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        raise
    with connection:
        yield connection


def _peer(connection: socket.socket) -> Any:
    if connection.family not in (socket.AF_INET, socket.AF_INET6):
        return None
    host, port = connection.getpeername()[:2]
    return ipaddress.ip_address(host.partition("%")[0]), port


def _address(locator: str) -> Any:
    """Of a locator such as `tls/[::ffff:192.0.2.7]:49090`: address and port; None for what has none."""
    host, _, port = locator.partition("/")[2].partition("#")[0].partition("?")[0].rpartition(":")
    try:
        return ipaddress.ip_address(host.removeprefix("[").removesuffix("]").partition("%")[0]), int(port)
    except ValueError:
        return None
