"""Connects to a gateway by the first of its hosts that answers.

Zenoh tries a client's endpoints in turn. It spends `connect/timeout_ms` on the first, or up to `open_timeout` on each
that drops packets or has no address. A Stop must not wait for that, so each host is tried on its own thread, which
begins shortly after the previous one (RFC 8305, "happy eyeballs").

The session that opens first is kept. It has all endpoints, its own first. If its link breaks, Zenoh tries them in turn,
and the session keeps its declarations.
"""

import json
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Final

import zenoh

from gateway.errors import UnreachedError, ZenohError
from gateway.zenoh_config import CANNOT_CONNECT, connect_endpoints, get, one_line, why_not_opened

NEXT_HOST_S: Final = 0.2
"""After this time, or as soon as a host fails, the next host is tried.

A LAN answers in about 10 ms, so usually one host is tried. A Stop through the third takes less than half a second.
"""
OPEN_TIMEOUT_MS: Final = 1000
"""The time for one of several hosts, with name and handshake, unless the Zenoh file changes Zenoh's 10 s."""
_OPEN_TIMEOUT: Final = "transport/unicast/open_timeout"
_ZENOHS_OPEN_TIMEOUT_MS: Final = 10_000
_PAUSE_S: Final = 0.1
_MAX_PAUSE_S: Final = 0.5


class Hosts:
    """The endpoints of a client's configuration."""

    def __init__(self, config: zenoh.Config, timeout_s: float) -> None:
        """`config` is kept and changed. `timeout_s` is the longest wait of `open` for a session."""
        self.endpoints = connect_endpoints(config)
        self.config = config
        self._timeout_s = timeout_s
        config.insert_json5("connect/timeout_ms", "0")  # each endpoint once; `Search` retries
        if get(config, _OPEN_TIMEOUT) == _ZENOHS_OPEN_TIMEOUT_MS:
            alone_ms = max(OPEN_TIMEOUT_MS, min(round(timeout_s * 1000), _ZENOHS_OPEN_TIMEOUT_MS))
            config.insert_json5(_OPEN_TIMEOUT, str(OPEN_TIMEOUT_MS if len(self.endpoints) > 1 else alone_ms))

    def open(self) -> zenoh.Session:
        """Open a session. Raises ZenohError, one line, after `timeout_s` at the latest."""
        opened: SimpleQueue[zenoh.Session | None] = SimpleQueue()
        search = Search(self, time.monotonic() + self._timeout_s, opened.put)
        session = None
        try:
            with suppress(Empty):
                session = opened.get(timeout=self._timeout_s)
        finally:
            if session is None:
                search.close()
        if session is None:
            kind = UnreachedError if search.error == CANNOT_CONNECT else ZenohError
            raise kind(why_not_opened(search.error, self.endpoints))
        return session

    def config_for(self, first: int) -> zenoh.Config:
        """Return the configuration of a session that tries endpoint number `first` first."""
        if first == 0:
            return self.config
        config = zenoh.Config.from_json5(str(self.config))
        config.insert_json5("connect/endpoints", json.dumps([*self.endpoints[first:], *self.endpoints[:first]]))
        return config


class Search:
    """Tries all hosts repeatedly until one answers, `close` is called, or the time is over.

    `found` is called on another thread, with the session, or with None if no host is left to try.
    """

    def __init__(
        self,
        hosts: Hosts,
        end_s: float,
        found: Callable[[zenoh.Session | None], None],
        next_host_s: float = NEXT_HOST_S,
    ) -> None:
        self.error = CANNOT_CONNECT
        """Why no session could be opened; a permanent error takes precedence."""
        self._hosts = hosts
        self._end_s = end_s
        self._found = found
        self._next_host_s = next_host_s
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._session: zenoh.Session | None = None
        self._begin = [threading.Event() for _ in hosts.endpoints or ("scouting",)]
        self._trying = len(self._begin)
        for place in range(self._trying):
            _Thread(target=self._try, args=(place,), name=f"open host {place}").start()

    def close(self) -> None:
        """Give up, and close the session if one was found."""
        with self._lock:
            session, self._session = self._session, None
            self._end()
        if session is not None:
            # With a frozen gateway this takes seconds.
            _Thread(target=_close, args=(session,), name="close").start()

    def _end(self) -> None:
        self._over.set()
        for begin in self._begin:
            begin.set()

    def _try(self, place: int) -> None:
        self._begin[place].wait(place * self._next_host_s)
        pause_s = _PAUSE_S
        while not self._over.is_set() and time.monotonic() < self._end_s:
            try:
                session = zenoh.open(self._hosts.config_for(place))
            except zenoh.ZError as error:
                if CANNOT_CONNECT not in str(error):
                    self.error = one_line(error)
                    break
            else:
                self._offer(session)
                break
            if place + 1 < len(self._begin):
                self._begin[place + 1].set()
            self._over.wait(min(pause_s, max(0.0, self._end_s - time.monotonic())))
            pause_s = min(2 * pause_s, _MAX_PAUSE_S)
        with self._lock:
            self._trying -= 1
            nothing_left = not self._trying and not self._over.is_set()
        if nothing_left:
            self._found(None)

    def _offer(self, session: zenoh.Session) -> None:
        with self._lock:
            late = self._over.is_set()
            if not late:
                self._session = session
                self._end()
        if late:
            _close(session)
        else:
            self._found(session)


class _Thread(threading.Thread):
    """Not a daemon: Python aborts if a daemon returns from Zenoh while the interpreter ends.

    So a program's end waits up to `open_timeout` for a pending attempt.
    """


def under_way() -> bool:
    """Return whether an attempt to connect is still pending, whose result is no longer needed."""
    return any(isinstance(thread, _Thread) for thread in threading.enumerate())


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):
        session.close()
