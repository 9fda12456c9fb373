"""Opens a session by the first host that answers, and asks: one Zenoh query, until a valid answer arrives.

Zenoh tries a client's endpoints in turn. It spends `connect/timeout_ms` on the first, or up to `open_timeout` on each
that drops packets or has no address. A Stop must not wait for that, so each host is tried on its own thread, which
begins shortly after the previous one (RFC 8305, "happy eyeballs").

The session that opens first is kept. It has all endpoints, its own first. If its link breaks, Zenoh tries them in turn,
and the session keeps its declarations.

A question is repeated, and sent by other sessions. Invalid replies are ignored, such as the `{}` of a recorder that
replies to everything. All repliers are recorded.
"""

import json
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Annotated, Final, Generic, Literal, TypeVar

import zenoh
from pydantic import BaseModel, Field, ValidationError

from gateway.errors import UnreachedError, ZenohError
from gateway.people.client.patience import Patience, Query, QuestionStep
from gateway.zenoh.config import CANNOT_CONNECT, connect_endpoints, get, one_line, why_not_opened
from schemas.ack import Ack

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
        self.id: str | None = get(config, "id")
        """The Zenoh id that the file sets, if any."""
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

    def open_at(self, first: int) -> zenoh.Session:
        """Open a session that tries endpoint number `first` first. Raises ZError.

        A gateway admits one session of each id. Where ours is taken, a Stop goes by another id.
        """
        config = self.config
        if first > 0:
            config = zenoh.Config.from_json5(str(config))
            config.insert_json5("connect/endpoints", json.dumps([*self.endpoints[first:], *self.endpoints[:first]]))
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if self.id is None or CANNOT_CONNECT not in str(error):
                raise
            config = zenoh.Config.from_json5(str(config))
            config.insert_json5("id", "null")
            return zenoh.open(config)


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
            close_later(session)

    def _end(self) -> None:
        self._over.set()
        for begin in self._begin:
            begin.set()

    def _try(self, place: int) -> None:
        self._begin[place].wait(place * self._next_host_s)
        pause_s = _PAUSE_S
        while not self._over.is_set() and time.monotonic() < self._end_s:
            try:
                session = self._hosts.open_at(place)
            except zenoh.ZError as error:
                if CANNOT_CONNECT not in str(error):
                    self.error = one_line(error)
                    break
            else:
                with self._lock:
                    late = self._over.is_set()
                    if not late:
                        self._session = session
                        self._end()
                if late:
                    _close(session)
                else:
                    self._found(session)
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


class _Thread(threading.Thread):
    """Not a daemon: Python aborts if a daemon returns from Zenoh while the interpreter ends.

    So a program's end waits up to `open_timeout` for a pending attempt.
    """


def under_way() -> bool:
    """Return whether an attempt to connect is still pending, whose result is no longer needed."""
    return any(isinstance(thread, _Thread) for thread in threading.enumerate())


def close_later(session: zenoh.Session) -> None:
    """Close it on a thread, since with a frozen gateway this takes seconds."""
    with suppress(RuntimeError):  # the program has ended
        _Thread(target=_close, args=(session,), name="close").start()


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):
        session.close()


A = TypeVar("A", bound=BaseModel)

JSON: Final = "application/json"


class Question(Generic[A]):
    """One query and its answer; `ask` may be called once."""

    def __init__(
        self,
        key: str,
        payload: str | None,
        read: Callable[[bytes], A],
        priority: zenoh.Priority | None = None,
        sent_by: zenoh.SourceInfo | None = None,
    ) -> None:
        """`read` converts bytes to an answer, or raises ValidationError."""
        self.answerers: set[str] = set()
        """Zenoh ids of all programs that replied, validly or not."""
        self._key = key
        self._payload = payload
        self._read = read
        self._priority = priority
        self._sent_by = sent_by
        self._sessions: list[zenoh.Session] = []
        self._received: SimpleQueue[Callable[[], None] | zenoh.Session | None] = SimpleQueue()
        self._patience: Patience[A]

    def ask(self, session: zenoh.Session, end_s: float, *, again: bool, other_ways: Hosts | None) -> A | None:
        """Return the answer, or None: after `end_s`, or (not `again`) if all programs declined or none was reached."""
        patience = self._patience = Patience(time.monotonic(), end_s, again=again, other_ways=other_ways is not None)
        self._send(session, end_s)
        search: Search | None = None
        try:
            while (step := patience.step(time.monotonic())) is not QuestionStep.OVER:
                if step is QuestionStep.AGAIN:
                    for each in self._sessions:
                        self._send(each, end_s)
                elif step is QuestionStep.OTHER_WAY and other_ways is not None:
                    search = Search(other_ways, end_s, self._received.put, next_host_s=0)
                else:
                    with suppress(Empty):
                        if (found := self._take(patience.next_s)) is not None:
                            self._send(found, end_s)
            return patience.answer
        finally:
            if search is not None:
                search.close()

    def wait_for_others(self, wait_s: float) -> None:
        """After `ask`: record further repliers until all have replied or declined, for `wait_s` at most."""
        end_s = time.monotonic() + wait_s
        with suppress(Empty):
            while self._patience.under_way:
                self._take(end_s)

    def _send(self, session: zenoh.Session, end_s: float) -> None:
        if session not in self._sessions:
            self._sessions.append(session)
        query = self._patience.sent(time.monotonic())
        received = self._received

        def receive(reply: zenoh.Reply | None = None) -> None:
            received.put(lambda: self._judge(session, query, reply))

        session.get(
            self._key,
            # `indirect` starts a thread for each query and took nearly twice as long; a put never waits.
            zenoh.handlers.Callback(receive, receive, indirect=False),
            target=zenoh.QueryTarget.ALL,  # by default Zenoh asks only queryables declared complete
            payload=self._payload,
            encoding=None if self._payload is None else JSON,
            timeout=max(0.001, end_s - time.monotonic()),
            priority=self._priority,
            source_info=self._sent_by,
            consolidation=zenoh.ConsolidationMode.NONE,  # otherwise Zenoh delays answers until the query has ended
        )

    def _take(self, until_s: float) -> zenoh.Session | None:
        """Process the next reply, or return the session that the search found. Raises Empty."""
        received = self._received.get(timeout=max(0.0, until_s - time.monotonic()))
        if isinstance(received, zenoh.Session) or received is None:
            return received
        received()
        return None

    def _judge(self, session: zenoh.Session, query: Query[A], reply: zenoh.Reply | None) -> None:
        """Take a reply; None is the query's end."""
        if reply is None:
            self._patience.ended(query, time.monotonic())
        elif reply.ok is not None:
            replier = "" if reply.replier_id is None else str(reply.replier_id.zid)
            self.answerers.add(replier)
            with suppress(ValidationError):
                answer = self._read(reply.ok.payload.to_bytes())
                # A router never replies: behind it, any program may be the dialled one.
                dialled = [str(link.zid) for link in session.info.transports() if link.whatami == zenoh.WhatAmI.PEER]
                self._patience.replied(query, answer, own=not dialled or replier in dialled)


class EstopAck(Ack):
    """The gateway always accepts an emergency stop. A reply without these fields is another program's."""

    accepted: Literal[True]
    stop_frames: Annotated[int, Field(ge=0)]
    latency_us: Annotated[float, Field(ge=0, allow_inf_nan=False)]

    def __repr_name__(self) -> str:
        return Ack.__name__
