"""One Zenoh query to the gateway, repeated and sent by other sessions until an answer comes that can be its own.

Without access control anybody may answer on the gateway's keys: a recorder that answers everything with `{}`, or a
program that pretends to be the gateway. What cannot be an answer is ignored, and everybody who answers is noted.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Final, Generic, TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

from gateway.people.client.hosts import Hosts, Search

A = TypeVar("A", bound=BaseModel)

JSON: Final = "application/json"
AGAIN_S: Final = 0.05
"""A client that lost the gateway tries to reach it again after 0.1 s (`gateway.zenoh_config`)."""
ATTEMPT_S: Final = 1.0
"""After so long without an answer a Stop is requested again: the link may be dead without a sign.

The answer to an earlier attempt counts as well: on a slow bus six Stops take longer than this.
"""
OTHER_WAY_S: Final = 0.2
"""After so long without an answer a Stop is sent by another session as well.

An answer takes milliseconds. Zenoh notices a dead link only after its lease, and then tries the hosts in turn.
"""


@dataclass(eq=False)
class _Query(Generic[A]):
    session: zenoh.Session
    answer: A | None = None
    """An answer that did not come from the program at the other end of the session's link."""


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
        self._elsewhere: A | None = None
        self._received: SimpleQueue[tuple[_Query[A], zenoh.Reply | None] | zenoh.Session | None] = SimpleQueue()
        self._under_way = 0

    def ask(self, session: zenoh.Session, end_s: float, *, again: bool, other_ways: Hosts | None) -> A | None:
        """The answer. None: the time is over, or everybody has declined and `again` is false."""
        self._send(session, end_s)
        ask_again_s = time.monotonic() + ATTEMPT_S if again else end_s
        other_way_s = time.monotonic() + OTHER_WAY_S if other_ways else end_s
        search: Search | None = None
        try:
            while (now_s := time.monotonic()) < end_s:
                if other_ways and search is None and now_s >= other_way_s:
                    search, other_way_s = Search(other_ways, end_s, self._received.put, next_host_s=0), end_s
                if now_s >= ask_again_s:
                    ask_again_s = now_s + ATTEMPT_S
                    for each in self._sessions:
                        self._send(each, end_s)
                try:
                    received = self._received.get(timeout=max(0.0, min(end_s, ask_again_s, other_way_s) - now_s))
                except Empty:
                    continue
                if isinstance(received, zenoh.Session):
                    self._send(received, end_s)
                elif received is not None and (answer := self._take(*received)) is not None:
                    return answer
                if not self._under_way:  # Zenoh ends a query at once if there is no link, or if it is lost
                    if not again:
                        break
                    ask_again_s = min(ask_again_s, now_s + AGAIN_S)
                    if other_ways and search is None:
                        other_way_s = now_s
            return self._elsewhere
        finally:
            if search is not None:
                search.close()

    def wait_for_others(self, wait_s: float) -> None:
        """After `ask`: note who else answers, until everybody has answered or declined, for at most `wait_s`."""
        end_s = time.monotonic() + wait_s
        while self._under_way:
            try:
                received = self._received.get(timeout=max(0.0, end_s - time.monotonic()))
            except Empty:
                return
            if isinstance(received, tuple):
                self._take(*received)

    def _send(self, session: zenoh.Session, end_s: float) -> None:
        if session not in self._sessions:
            self._sessions.append(session)
        query: _Query[A] = _Query(session)
        received = self._received

        def receive(reply: zenoh.Reply | None = None) -> None:
            received.put((query, reply))

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
        self._under_way += 1

    def _take(self, query: _Query[A], reply: zenoh.Reply | None) -> A | None:
        """Process a reply, or None for the query's end; returns the answer once one counts."""
        if reply is None:
            self._under_way -= 1
            return query.answer
        if reply.ok is None:
            return None
        replier = "" if reply.replier_id is None else str(reply.replier_id.zid)
        self.answerers.add(replier)
        try:
            answer = self._read(reply.ok.payload.to_bytes())
        except ValidationError:
            return None
        if _is_own(query.session, replier):
            return answer
        query.answer = query.answer or answer
        self._elsewhere = self._elsewhere or answer
        return None


def _is_own(session: zenoh.Session, replier: str) -> bool:
    """Whether the answer is that of the program that was dialled, or may be.

    A gateway that is dialled directly answers for itself. Another's answer counts only when all have had their say: the
    gateway may be behind the one that was dialled. A router never answers, so behind one anybody may be the gateway.
    """
    dialled = [str(link.zid) for link in session.info.transports() if link.whatami == zenoh.WhatAmI.PEER]
    return not dialled or replier in dialled
