"""One Zenoh query to the gateway, repeated and sent by other sessions until an answer comes that can be its own.

What cannot be an answer is ignored: a recorder answers everything with `{}`. Everybody who answers is noted.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Final, Generic, TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

from gateway.people.client.hosts import Hosts, Search
from gateway.people.client.patience import Patience, Query, QuestionStep

A = TypeVar("A", bound=BaseModel)

JSON: Final = "application/json"


class Question(Generic[A]):
    """One question; `ask` may be called once."""

    def __init__(
        self, key: str, payload: str | None, read: Callable[[bytes], A], priority: zenoh.Priority | None = None
    ) -> None:
        """`read` turns bytes into an answer, or raises ValidationError."""
        self.answerers: set[str] = set()
        """Zenoh ids of all programs that have replied, valid or not."""
        self._key = key
        self._payload = payload
        self._read = read
        self._priority = priority
        self._sessions: list[zenoh.Session] = []
        self._received: SimpleQueue[Callable[[], None] | zenoh.Session | None] = SimpleQueue()
        self._patience: Patience[A]

    def ask(self, session: zenoh.Session, end_s: float, *, again: bool, other_ways: Hosts | None) -> A | None:
        """The answer. None: the time is over, or everybody has declined and `again` is false."""
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
        """After `ask`: note who else answers, until everybody has answered or declined, for at most `wait_s`."""
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
            # Not `indirect`: that starts a thread for each question, and took nearly twice the time. A put never waits.
            zenoh.handlers.Callback(receive, receive, indirect=False),
            target=zenoh.QueryTarget.ALL,  # by default only a queryable that claims to be complete is asked
            payload=self._payload,
            encoding=None if self._payload is None else JSON,
            timeout=max(0.001, end_s - time.monotonic()),
            priority=self._priority,
            consolidation=zenoh.ConsolidationMode.NONE,  # otherwise Zenoh holds answers back until the query has ended
        )

    def _take(self, until_s: float) -> zenoh.Session | None:
        """Judge what comes in next; returns the session that was searched for. Raises Empty."""
        received = self._received.get(timeout=max(0.0, until_s - time.monotonic()))
        if isinstance(received, zenoh.Session) or received is None:
            return received
        received()
        return None

    def _judge(self, session: zenoh.Session, query: Query[A], reply: zenoh.Reply | None) -> None:
        """A reply, or None for the query's end."""
        if reply is None:
            self._patience.ended(query, time.monotonic())
        elif reply.ok is not None:
            replier = "" if reply.replier_id is None else str(reply.replier_id.zid)
            self.answerers.add(replier)
            with suppress(ValidationError):
                answer = self._read(reply.ok.payload.to_bytes())
                self._patience.replied(query, answer, own=_is_own(session, replier))


def _is_own(session: zenoh.Session, replier: str) -> bool:
    """Whether the answer is that of the program that was dialled, or may be.

    A router never answers, so behind one anybody may be the gateway.
    """
    dialled = [str(link.zid) for link in session.info.transports() if link.whatami == zenoh.WhatAmI.PEER]
    return not dialled or replier in dialled
