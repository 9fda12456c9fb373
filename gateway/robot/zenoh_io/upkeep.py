"""Opens Zenoh, and looks after what it does not report: missing addresses, unreached routers, expiring certificates.

An address may not exist yet: a phone's hotspot, DHCP, a name server, an address family of the kernel. The gateway
listens on the addresses that exist. Zenoh tries the others once a second, in the same session (measured with 1.10.2: it
listens within a second after the address appears). A port that is taken is a fault and ends the start.

A background thread checks, and reports to the log, systemd and the state. No finding stops the service.
"""

import datetime as dt
import errno
import logging
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import zenoh

from gateway import certs
from gateway.endpoints import host_and_port
from gateway.errors import GatewayError, ZenohError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.zenoh_config import connect_endpoints, first_expiry, insert, listen_endpoints, open_session, why_not_opened

PERIOD_S: Final = 1.0
GRACE_S: Final = 3.0
"""Time to connect to a router at the start. Zenoh retries at least once a second."""
CLOCK_S: Final = 3600.0
"""Period if only certificates can change. The clock may be set after the start."""
_LINKS: Final = {
    "tcp": socket.SOCK_STREAM,
    "tls": socket.SOCK_STREAM,
    "ws": socket.SOCK_STREAM,
    "quic": socket.SOCK_DGRAM,
    "udp": socket.SOCK_DGRAM,
}
_LAST_PORT: Final = 65_535
_LATE: Final = frozenset({errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT})
_RETRY: Final = (
    "exit_on_failure=false;retry_period_init_ms=1000;retry_period_max_ms=1000;retry_period_increase_factor=1"
)
"""Zenoh's settings for one endpoint, after its #."""
_OTHERS_MS: Final = 1000
"""How long Zenoh tries the other endpoints. With 0 it would retry no endpoint, not even the late ones."""
_ALL, _ALL_IPV4 = "[::]", "0.0.0.0"  # noqa: S104 (as the configuration has it)

logger = logging.getLogger(__name__)


class Upkeep:
    """Opens one session. Its thread checks from `start` until `close`."""

    def __init__(
        self,
        config: zenoh.Config,
        show: Callable[[str, tuple[str, ...]], None],
        wall_clock: Callable[[], dt.datetime],
    ) -> None:
        """`show` is called at each change, with a sentence for `systemctl status` and the missing endpoints."""
        self._config = config
        self._show = show
        self._wall_clock = wall_clock
        self._missing: tuple[str, ...] = ()
        self._pages: dict[str, Callable[[], None]] = {}
        self._dials = connect_endpoints(config)
        self._reached: bool | None = None
        self._fault: str | None = None
        self._shown = "takes commands"
        self.first_expiry = first_expiry(config)
        """The first expiry of the certificates loaded at the start. A renewed one is used from the next start on."""
        self._closed = threading.Event()

    def serve(self, address: str, page: Callable[[], None]) -> None:
        """Call `page`, which listens on `address` (`host:port`), now or once the address exists."""
        endpoint = f"tcp/{address}"
        fault = bind_fault(endpoint)
        if fault is None or not is_late(fault):
            page()
            return
        self._pages[endpoint] = page
        self._miss(endpoint, fault)

    def open(self) -> zenoh.Session:
        """Return a session that listens on the existing addresses now and on the others later. Blocks.

        Raises ZenohError if a port is taken or Zenoh does not open.
        """
        endpoints = listen_endpoints(self._config)
        faults = {each: fault for each in endpoints if (fault := bind_fault(each)) is not None}
        late = {each: fault for each, fault in faults.items() if is_late(fault)}
        if not late:
            return open_session(self._config)
        for each in faults.keys() - late.keys():  # Zenoh's own message would not name the endpoint
            raise ZenohError(why_not_opened(str(faults[each]), [each]))
        tried = dict.fromkeys(self._tried(each, late[each]) if each in late else each for each in endpoints)
        insert(self._config, "listen/endpoints", list(tried), "zenoh.listen")
        insert(self._config, "listen/timeout_ms", _OTHERS_MS, "zenoh.listen")
        try:
            return open_session(self._config)
        finally:
            insert(self._config, "listen/endpoints", endpoints, "zenoh.listen")

    def _tried(self, endpoint: str, fault: OSError) -> str:
        """Return what Zenoh tries for a late endpoint."""
        if _ALL in endpoint and fault.errno == errno.EAFNOSUPPORT:
            return endpoint.replace(_ALL, _ALL_IPV4)  # all IPv4 addresses are all that exist
        self._miss(endpoint, fault)
        return f"{endpoint}{';' if '#' in endpoint else '#'}{_RETRY}"

    def _miss(self, endpoint: str, fault: OSError) -> None:
        logger.warning("does not listen on %s yet, and keeps trying: %s", endpoint, fault.strerror)
        self._missing += (endpoint,)

    def start(self, session: zenoh.Session) -> None:
        """Start the thread."""
        self._thread = threading.Thread(target=self._run, args=(session,), name="upkeep", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread. Blocks, so do not call it on the loop's thread."""
        self._closed.set()
        self._thread.join()

    def _run(self, session: zenoh.Session) -> None:
        prefer_thread(PAGE_PRIORITY)
        grace_ends_s = time.monotonic() + GRACE_S
        with suppress(zenoh.ZError):  # the session was closed
            while True:
                self._missing = tuple(each for each in self._missing if not self._listens_on(each))
                if self._dials:
                    self._check_links(session, in_grace=time.monotonic() < grace_ends_s)
                self._check_certificates()
                missing = f"; does not listen on {', '.join(self._missing)} yet" if self._missing else ""
                unreached = f"; {', '.join(self._dials)} is not reached" if self._reached is False else ""
                status = f"takes commands{missing}{unreached}{f'; {self._fault}' if self._fault else ''}"
                if status != self._shown:
                    self._shown = status
                    self._show(status, self._missing)
                if self._closed.wait(PERIOD_S if self._dials or self._missing else CLOCK_S):
                    return

    def _listens_on(self, endpoint: str) -> bool:
        """Return whether the gateway listens on a missing endpoint by now. Waits for name servers."""
        fault = bind_fault(endpoint)
        page = self._pages.get(endpoint)
        if page is not None and fault is None:
            try:
                page()
            except GatewayError as error:
                logger.warning("%s", error)
                return False
        elif page is not None or fault is None or fault.errno != errno.EADDRINUSE:  # in use by Zenoh
            return False
        logger.info("listens on %s, too", endpoint)
        return True

    def _check_links(self, session: zenoh.Session, *, in_grace: bool) -> None:
        ports = _ports(self._dials) - _ports(listen_endpoints(self._config))
        reached = any(_ports([str(link.dst)]) & ports for link in session.info.links())
        if reached is self._reached or (in_grace and not reached):
            return
        self._reached = reached
        where = ", ".join(self._dials)
        if reached:
            logger.info("%s is reached", where)
        else:
            logger.warning(
                "%s is not reached: until it is, nobody behind it can command this robot or watch it. The gateway "
                "keeps trying; `sudo hexapod-gateway check` finds the cause",
                where,
            )

    def _check_certificates(self) -> None:
        """Find the certificate that expires soon. Log it at each change: once a day."""
        first, now = self.first_expiry, self._wall_clock()
        soon = None if first is None else certs.expires_soon(first.file.name, first.end, now)
        fault = None
        if first is not None and soon is not None:
            result = "then nobody can connect" if now < first.end else "nobody can connect (is this clock right?)"
            fault = f"{soon}: {result}; `sudo hexapod-gateway check` shows how to renew it, then restart the service"
        if fault and fault != self._fault:
            logger.warning(fault)
        self._fault = fault


def _ports(endpoints: list[str]) -> set[str]:
    return {port for _, port in map(host_and_port, endpoints) if port.isdecimal()}


def bind_fault(endpoint: str) -> OSError | None:
    """Return why no program could listen on an endpoint now; None if one could, or if the endpoint has no port."""
    kind, (host, port) = _LINKS.get(endpoint.partition("/")[0]), host_and_port(endpoint)
    if kind is None or not port.isdecimal():
        return None
    if int(port) > _LAST_PORT:  # getaddrinfo would take the lower 16 bits
        return OSError(errno.EINVAL, f"ports end at {_LAST_PORT}")
    first = None
    try:
        found = socket.getaddrinfo(host, int(port), type=kind)
    except OSError as error:  # also a name that no server knows
        return error
    for family, _, _, _, address in found:
        try:
            with socket.socket(family, kind) as probe:
                if kind is socket.SOCK_STREAM:  # as Zenoh does: a recently closed connection is no obstacle
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
        except OSError as error:
            first = first or error
        else:
            return None
    return first


def is_late(fault: OSError) -> bool:
    """Return whether the fault may end without a change of the settings: the name or address does not exist yet."""
    return isinstance(fault, socket.gaierror) or fault.errno in _LATE
