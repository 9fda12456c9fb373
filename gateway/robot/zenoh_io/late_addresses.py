"""Endpoints whose address does not exist yet: a phone's hotspot, DHCP, a name server, an address family of the kernel.

The gateway listens on the addresses that exist. Zenoh tries the others once a second, in the same session (measured
with 1.10.2: it listens within a second after the address appears). A port that is taken is a fault and ends the start.
"""

import errno
import logging
import socket
from collections.abc import Callable
from typing import Final

import zenoh

from gateway.endpoints import host_and_port
from gateway.errors import GatewayError, ZenohError
from gateway.zenoh_config import insert, listen_endpoints, open_session, why_not_opened

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
_ALL, _ALL_IPV4 = "::", "0.0.0.0"  # noqa: S104 (as the configuration has it)

logger = logging.getLogger(__name__)


class LateAddresses:
    """The late endpoints of one session. `report` is called with the missing ones, at first and at each change."""

    def __init__(self, report: Callable[[tuple[str, ...]], None] = lambda _: None) -> None:
        self._report = report
        self.missing: tuple[str, ...] = ()
        self._seen: tuple[str, ...] = ()
        self._pages: dict[str, Callable[[], None]] = {}

    def serve(self, address: str, page: Callable[[], None]) -> None:
        """Call `page`, which listens on `address` (`host:port`), now or once the address exists."""
        endpoint = f"tcp/{address}"
        fault = bind_fault(endpoint)
        if fault is None or not is_late(fault):
            page()
            return
        self._pages[endpoint] = page
        self._miss(endpoint, fault)

    def open(self, config: zenoh.Config) -> zenoh.Session:
        """Return a session that listens on the existing addresses now and on the others later. Blocks.

        Raises ZenohError if a port is taken or Zenoh does not open.
        """
        endpoints = listen_endpoints(config)
        faults = {each: fault for each in endpoints if (fault := bind_fault(each)) is not None}
        late = {each: fault for each, fault in faults.items() if is_late(fault)}
        if not late:
            return open_session(config)
        for each in faults.keys() - late.keys():  # Zenoh's own message would not name the endpoint
            raise ZenohError(why_not_opened(str(faults[each]), [each]))
        tried = [self._tried(each, late[each]) if each in late else each for each in endpoints]
        insert(config, "listen/endpoints", [*dict.fromkeys(tried)], "zenoh.listen")
        insert(config, "listen/timeout_ms", _OTHERS_MS, "zenoh.listen")
        try:
            return open_session(config)
        finally:
            insert(config, "listen/endpoints", endpoints, "zenoh.listen")

    def _tried(self, endpoint: str, fault: OSError) -> str:
        """Return what Zenoh tries for a late endpoint."""
        if host_and_port(endpoint)[0] == _ALL and fault.errno == errno.EAFNOSUPPORT:
            return endpoint.replace(f"[{_ALL}]", _ALL_IPV4)  # all IPv4 addresses are all that exist
        self._miss(endpoint, fault)
        return f"{endpoint}{';' if '#' in endpoint else '#'}{_RETRY}"

    def _miss(self, endpoint: str, fault: OSError) -> None:
        logger.warning("does not listen on %s yet, and keeps trying: %s", endpoint, fault.strerror)
        self.missing += (endpoint,)

    def check(self) -> None:
        """Check the missing endpoints, and report a change. Waits for name servers."""
        still = tuple(each for each in self.missing if not self._is_there(each))
        for each in set(self.missing) - set(still):
            logger.info("listens on %s, too", each)
        self.missing = still
        if still != self._seen:
            self._seen = still
            self._report(still)

    def _is_there(self, endpoint: str) -> bool:
        fault = bind_fault(endpoint)
        if endpoint not in self._pages:
            return fault is not None and fault.errno == errno.EADDRINUSE  # by Zenoh
        if fault is not None:
            return False
        try:
            self._pages[endpoint]()
        except GatewayError as error:
            logger.warning("%s", error)
            return False
        return True


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
