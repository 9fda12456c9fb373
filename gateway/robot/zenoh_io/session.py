"""The service's Zenoh session: its configuration, its opening, and what Zenoh does not report of it.

An address may not exist yet: a phone's hotspot, DHCP, a name server, an address family of the kernel. The gateway
listens on the addresses that exist. Zenoh tries the others once a second, in the same session (measured with 1.10.2: it
listens within a second after the address appears). A port that is taken is a fault and ends the start.

A background thread looks for missing addresses, unreached routers and expiring certificates, and reports to the log,
systemd and the state. No finding stops the service.
"""

import datetime as dt
import errno
import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Final

import zenoh

from gateway import certs
from gateway.errors import ConfigError, GatewayError, ZenohError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.host.settings_table import DEFAULT_LISTEN, ZenohSettings
from gateway.robot.zenoh_io import exposure
from gateway.zenoh.config import (
    CA,
    TLS,
    connect_endpoints,
    first_expiry,
    get,
    insert,
    listen_endpoints,
    load_config,
    open_session,
    scouting_and_shared_memory_off,
    why_not_opened,
)
from gateway.zenoh.endpoints import host_and_port
from gateway.zenoh.limits import ACCEPT_PENDING, ACCEPT_TIMEOUT_MS, MAX_MESSAGE_SIZE, MAX_SESSIONS

UNREAD_US: Final = 20_000
"""How long a reply may wait for a client that does not read, before Zenoh closes that client's link.

When a flood pushes a query out of its ring, Zenoh sends the query's end from a receiving thread that holds the ring's
lock, for which the loop waits. During 18 000 queries a second of a client that read no reply, watchdog Stops were
546 ms late with 500 ms here. With 20 ms none of 147 was later than 1.5 ms; one due in those 20 ms would wait for their
end. At that rate a client that reads may lose its link (twice in 32 s), at 50 queries a second not, down to 300 kbit/s.
"""
_UNREAD_US_KEY: Final = "transport/link/tx/queue/congestion_control/block/wait_before_close"

_MAX_MESSAGE_SIZE_KEY: Final = "transport/link/rx/max_message_size"
_MOST: Final = {
    "transport/unicast/max_sessions": MAX_SESSIONS,
    "transport/unicast/accept_pending": ACCEPT_PENDING,
    "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
}
"""Upper limits; a Zenoh file may set lower ones."""

RUNTIME: Final = f"(rx:(worker_threads:{MAX_SESSIONS}))"
"""A receiving thread for each session, in Zenoh's notation, so that no session waits for another. By default two
threads serve all sessions. A session that floods occupies one for 20 000 messages and more, and on a wildcard each
message goes into 26 rings; an emergency stop waited for that."""
_MOST_ENDPOINTS: Final = 64
"""More than any machine has addresses. `check` tried 8000 one by one in 15 s."""
_RUNTIME_VARIABLE: Final = "ZENOH_RUNTIME"

PERIOD_S: Final = 1.0
GRACE_LOOKS: Final = 3
"""Looks, one a second, before a router counts as not reached. Zenoh retries at least once a second."""
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
_NOWHERE: Final = (
    "nobody can reach this gateway, since it listens nowhere: set zenoh.listen to addresses of this machine, such as "
    "tcp/127.0.0.1:7447 (ip address lists them)"
)
_ALL, _ALL_IPV4 = "[::]", "0.0.0.0"  # noqa: S104 (as the configuration has it)

logger = logging.getLogger(__name__)


def receive_each_session_alone() -> None:
    """Set the number of Zenoh's receiving threads, unless the environment does. Call it before any use of Zenoh."""
    os.environ.setdefault(_RUNTIME_VARIABLE, RUNTIME)


def service_config(settings: ZenohSettings) -> zenoh.Config:
    """Return the Zenoh file's configuration with the settings and limits applied.

    Raises ConfigError if the file cannot be used, or would let anyone move the robot (`exposure.check`).
    """
    config = load_config(Path(settings.config)) if settings.config else zenoh.Config()
    if get(config, "mode") is None:
        config.insert_json5("mode", '"peer"')
    file_sets = get(config, "listen/endpoints") != get(zenoh.Config(), "listen/endpoints")  # Zenoh's is not empty
    if settings.listen is not DEFAULT_LISTEN or not file_sets:
        insert(config, "listen/endpoints", list(settings.listen), "zenoh.listen")
    if (count := len(listen_endpoints(config))) > _MOST_ENDPOINTS:
        fix = f"at most {_MOST_ENDPOINTS} are allowed; tls/0.0.0.0:7447 is all of IPv4"
        raise ConfigError(f"{settings.config or 'zenoh.listen'} lists {count} endpoints to listen on: {fix}")
    scouting_and_shared_memory_off(config)
    # Otherwise a gateway without its listener would start without an error but could not be reached.
    config.insert_json5("listen/exit_on_failure", "true")
    config.insert_json5(_UNREAD_US_KEY, str(UNREAD_US))
    config.insert_json5(_MAX_MESSAGE_SIZE_KEY, str(MAX_MESSAGE_SIZE))
    for key, most in _MOST.items():
        config.insert_json5(key, str(min(most, get(config, key) or most)))
    exposure.check(config, allow_insecure=settings.allow_insecure)
    return config


class Upkeep:
    """Opens one session. Its thread checks from `start` until `close`."""

    def __init__(self, config: zenoh.Config, show: Callable[[str, tuple[str, ...]], None]) -> None:
        """`show` is called at each change, with a sentence for `systemctl status` and the missing endpoints."""
        self._config = config
        self._show = show
        self._missing: dict[str, OSError] = {}
        """The endpoints on which the gateway does not listen yet, and why."""
        self._pages: dict[str, Callable[[], None]] = {}
        self._dials = connect_endpoints(config)
        self.first_expiry = first_expiry(config)
        """The first expiry of the certificates loaded at the start. A renewed one is used from the next start on."""
        self._closed = threading.Event()

    def serve(self, address: str, page: Callable[[], None]) -> None:
        """Call `page`, which listens on `address` (`host:port`), now or once the address exists."""
        endpoint = f"tcp/{address}"
        fault = bind_fault(endpoint)
        if fault is None or not is_late(fault):
            page()
        else:
            self._missing[endpoint], self._pages[endpoint] = fault, page

    def open(self) -> zenoh.Session:
        """Return a session that listens on the existing addresses now and on the others later. Blocks.

        Raises ZenohError if a port is taken or Zenoh does not open, and ConfigError for a key or CA of another set.
        """
        _check_pair(self._config)
        endpoints = listen_endpoints(self._config)
        faults = {each: fault for each in endpoints if (fault := bind_fault(each)) is not None}
        if not any(map(is_late, faults.values())):
            return open_session(self._config)
        tried = []
        for each in endpoints:
            fault = faults.get(each)
            if fault is None:
                tried.append(each)
            elif not is_late(fault):  # Zenoh's own message would not name the endpoint
                raise ZenohError(why_not_opened(str(fault), [each]))
            elif _ALL in each and fault.errno == errno.EAFNOSUPPORT:  # all IPv4 addresses are all that exist
                tried.append(each.replace(_ALL, _ALL_IPV4))
            else:
                self._missing[each] = fault
                tried.append(f"{each}{';' if '#' in each else '#'}{_RETRY}")
        insert(self._config, "listen/endpoints", list(dict.fromkeys(tried)), "zenoh.listen")
        insert(self._config, "listen/timeout_ms", _OTHERS_MS, "zenoh.listen")
        try:
            return open_session(self._config)
        finally:
            insert(self._config, "listen/endpoints", endpoints, "zenoh.listen")

    def start(self, session: zenoh.Session) -> None:
        self._thread = threading.Thread(target=self._run, args=(session,), name="upkeep", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread. Blocks, so do not call it on the loop's thread."""
        self._closed.set()
        self._thread.join()

    def _run(self, session: zenoh.Session) -> None:
        prefer_thread(PAGE_PRIORITY)
        shown: list[str] = []
        with suppress(zenoh.ZError):  # the session was closed
            for look in count():
                self._missing = {each: why for each, why in self._missing.items() if not self._listens_on(each)}
                found = [f"does not listen on {each} yet: {why.strerror}" for each, why in self._missing.items()]
                if not self._dials and self._missing.keys() >= set(listen_endpoints(self._config)) > set():
                    found.insert(0, _NOWHERE)
                if self._dials and look >= GRACE_LOOKS:
                    found += self._unreached(session)
                found += self._expiring()
                for each in found:
                    if each not in shown:
                        logger.warning("%s", each)
                if found != shown:
                    shown = found
                    self._show("; ".join(["takes commands", *found]), tuple(self._missing))
                if self._closed.wait(PERIOD_S if self._dials or self._missing else CLOCK_S):
                    return

    def _listens_on(self, endpoint: str) -> bool:
        """Return whether the gateway listens on a missing endpoint by now. Waits for name servers."""
        fault, page = bind_fault(endpoint), self._pages.get(endpoint)
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

    def _unreached(self, session: zenoh.Session) -> Iterator[str]:
        ports = _ports(self._dials) - _ports(listen_endpoints(self._config))
        if not any(_ports([str(link.dst)]) & ports for link in session.info.links()):
            yield f"{', '.join(self._dials)} is not reached, so nobody behind it can command or watch this robot"

    def _expiring(self) -> Iterator[str]:
        """Yield which certificate expires soon. The sentence changes once a day."""
        first, now = self.first_expiry, dt.datetime.now(dt.UTC)
        soon = None if first is None else certs.expires_soon(first.file.name, first.end, now)
        if first is not None and soon is not None:
            result = "then nobody can connect" if now < first.end else "nobody can connect (is this clock right?)"
            yield f"{soon}: {result}; `sudo hexapod-gateway check` shows how to renew it, then restart the service"


def _check_pair(config: zenoh.Config) -> None:
    """Raise ConfigError if key, certificate and CA contradict each other: Zenoh names no file, or accepts that."""
    names = [get(config, name) for name in (CA, f"{TLS}/listen_certificate", f"{TLS}/listen_private_key")]
    if all(names) and (fault := certs.folder.contradiction(*map(Path, names))):
        raise ConfigError(f"{fault}, so nobody can connect: sudo hexapod-gateway check shows what to copy")


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
