"""One Zenoh session of a test that has many: what it declared, and what has arrived at it."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from gateway.robot.zenoh_io.revoked import list_common_names
from gateway.zenoh_config import load_config
from tests.support.closing import Closing

DEPTH = 1000
POLL_S = 0.002  # several rings have no common wait; every loop below ends
LATE_S = 10.0


class Actor(Closing):
    """A session and what it declared."""

    def __init__(self) -> None:
        self._session: Any = None
        self._links: Any = None
        self._rings: list[Any] = []
        self._asked: list[str] = []
        self._kept: list[Any] = []

    def open(self, path: Path) -> str:
        """Opens the Zenoh file at `path`, as our programs do; the session's id."""
        config = load_config(path)
        list_common_names(config, None)  # as the service does with its own file
        self._session = zenoh.open(config)
        listener = self._session.info.declare_link_events_listener(RingChannel(DEPTH), history=True)
        self._links = listener.handler
        self._kept.append(listener)
        return str(self._session.zid())

    def serve(self) -> None:
        """Stands in for the gateway: takes commands and questions, says that it is alive."""
        self.subscribe("hexapod/**/cmd")
        self.queryable("hexapod/**/cmd")
        self.queryable("hexapod/state")
        self.token("hexapod/alive")

    def subscribe(self, key: str) -> None:
        self._keep(self._session.declare_subscriber(key, RingChannel(DEPTH)))

    def watch_alive(self, key: str) -> None:
        self._keep(self._session.liveliness().declare_subscriber(key, RingChannel(DEPTH), history=True))

    def queryable(self, key: str) -> None:
        def answer(query: zenoh.Query) -> None:
            self._asked.append(str(query.key_expr))
            with query:
                query.reply(query.key_expr, "answer to " + (query.payload.to_string() if query.payload else ""))

        self._kept.append(self._session.declare_queryable(key, answer))

    def token(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))

    def put(self, key: str, payload: str) -> None:
        self._session.put(key, payload, encoding="application/json")

    def delete(self, key: str) -> None:
        self._session.delete(key)

    def get(self, key: str, payload: str = "") -> list[str]:
        return [
            reply.ok.payload.to_string() for reply in self._session.get(key, payload=payload, timeout=5) if reply.ok
        ]

    def get_alive(self, key: str, count: int = 0) -> list[str]:
        """The tokens, once there are `count`: on a busy machine Zenoh now and then answers too early that none is."""
        found: list[str] = []

        def enough() -> bool:
            found[:] = [str(reply.ok.key_expr) for reply in self._session.liveliness().get(key, timeout=5) if reply.ok]
            return len(found) >= count

        _wait(enough)
        return found

    def taken(self, count: int = 0) -> list[list[Any]]:
        """What arrived at all subscriptions since last asked, once there are `count`: [verb, key, size of payload]."""
        found: list[list[Any]] = []

        def enough() -> bool:
            for ring in self._rings:
                while (sample := ring.try_recv()) is not None:
                    verb = "put" if sample.kind == zenoh.SampleKind.PUT else "delete"
                    found.append([verb, str(sample.key_expr), len(sample.payload.to_bytes())])
            return len(found) >= count

        _wait(enough)
        return found

    def asked(self) -> list[str]:
        """The keys of the questions that reached this session's queryables since last asked."""
        found, self._asked = self._asked, []
        return found

    def matching(self, key: str) -> bool:
        """Whether a publisher on `key` comes to see a subscriber."""
        publisher = self._session.declare_publisher(key)
        return _wait(lambda: bool(publisher.matching_status.matching))

    def wait_gone(self, zid: str) -> bool:
        """Whether the link to `zid` ends; all that came over it has been read by then."""

        def gone() -> bool:
            while (event := self._links.try_recv()) is not None:
                if event.kind == zenoh.SampleKind.DELETE and str(event.link.zid) == zid:
                    return True
            return False

        return _wait(gone)

    def identity(self, zid: str) -> str | None:
        """Whom the certificate of the link to `zid` names, once there is one."""
        found: dict[str, str | None] = {}

        def seen() -> bool:
            found.update({str(link.zid): link.auth_identifier for link in self._session.info.links()})
            return zid in found

        _wait(seen)
        return found[zid]

    def close(self) -> None:
        if self._session is not None:
            self._session.close()

    def _keep(self, subscriber: Any) -> None:
        self._kept.append(subscriber)
        self._rings.append(subscriber.handler)


def _wait(done: Callable[[], bool]) -> bool:
    end = time.monotonic() + LATE_S
    while not (seen := done()) and time.monotonic() < end:
        time.sleep(POLL_S)
    return seen
