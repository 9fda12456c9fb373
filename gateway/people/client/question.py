"""One Zenoh query to the gateway, repeated and sent by other sessions until a valid answer arrives.

Invalid replies are ignored, such as the `{}` of a recorder that replies to everything. All repliers are recorded.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Annotated, Final, Generic, Literal, TypeVar

import zenoh
from pydantic import BaseModel, Field, ValidationError

from gateway.people.client.hosts import Hosts, Search
from gateway.people.client.patience import Patience, Query, QuestionStep
from schemas.telemetry import Ack

A = TypeVar("A", bound=BaseModel)

JSON: Final = "application/json"


class Question(Generic[A]):
    """One query and its answer; `ask` may be called once."""

    def __init__(
        self, key: str, payload: str | None, read: Callable[[bytes], A], priority: zenoh.Priority | None = None
    ) -> None:
        """`read` converts bytes to an answer, or raises ValidationError."""
        self.answerers: set[str] = set()
        """Zenoh ids of all programs that replied, validly or not."""
        self._key = key
        self._payload = payload
        self._read = read
        self._priority = priority
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
