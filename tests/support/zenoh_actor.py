"""One Zenoh session in a process of its own, told what to do over stdin: a JSON list a line, a JSON value back.

`Remote` is the end that a test holds, `Actor` the end inside the process. Who may do what over TLS is only real between
processes.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from gateway.robot.zenoh_io.revoked import list_common_names
from gateway.zenoh_config import load_config
from tests.support.child import Child
from tests.support.closing import Closing

DEPTH = 1000
POLL_S = 0.002  # several rings have no common wait; every loop below ends
ANSWER_S = 20  # far above anything seen (0.2 s): a test that hangs must end, not flicker


class RemoteError(Exception):
    """The process answered with an error; its text is the error's."""


class Remote(Closing):
    """A process with an Actor; calling a method that is not here calls the Actor's."""

    def __init__(self) -> None:
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
        # As a service: relative paths in a Zenoh file must not depend on where it runs.
        self._child = Child([sys.executable, "-m", "tests.support.zenoh_actor"], environment, Path("/"))

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*arguments: object) -> Any:
            answer = json.loads(self._child.ask(json.dumps([name, *arguments]), ANSWER_S))
            if "error" in answer:
                raise RemoteError(answer["error"])
            return answer["ok"]

        return call

    def close(self) -> None:
        """Close its session, and end it."""
        with self._child, suppress(TimeoutError, BrokenPipeError):  # it may have ended
            self._child.ask(json.dumps(["leave"]), ANSWER_S)


class Actor:
    """A session and what it declared; each public method is a command."""

    def __init__(self) -> None:
        self._session: Any = None
        self._links: Any = None
        self._rings: list[Any] = []
        self._asked: list[str] = []
        self._kept: list[Any] = []

    def open(self, path: str, overrides: dict[str, Any], resolve: bool = True) -> str:
        """Opens the Zenoh file at `path`, as our programs do or (not `resolve`) as it stands; the session's id."""
        config = load_config(Path(path)) if resolve else zenoh.Config.from_file(path)
        list_common_names(config, None)  # as the service does with its own file
        for key, value in overrides.items():
            config.insert_json5(key, json.dumps(value))
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

    def get_alive(self, key: str, count: int = 0, seconds: float = 5) -> list[str]:
        """The tokens, once there are `count`: on a busy machine Zenoh now and then answers too early that none is."""
        found: list[str] = []

        def enough() -> bool:
            found[:] = [str(reply.ok.key_expr) for reply in self._session.liveliness().get(key, timeout=5) if reply.ok]
            return len(found) >= count

        _wait(enough, seconds)
        return found

    def taken(self, count: int = 0, seconds: float = 5) -> list[list[Any]]:
        """What arrived at all subscriptions since last asked, once there are `count`: [verb, key, size of payload]."""
        found: list[list[Any]] = []

        def enough() -> bool:
            for ring in self._rings:
                while (sample := ring.try_recv()) is not None:
                    verb = "put" if sample.kind == zenoh.SampleKind.PUT else "delete"
                    found.append([verb, str(sample.key_expr), len(sample.payload.to_bytes())])
            return len(found) >= count

        _wait(enough, seconds)
        return found

    def asked(self) -> list[str]:
        """The keys of the questions that reached this session's queryables since last asked."""
        found, self._asked = self._asked, []
        return found

    def matching(self, key: str, seconds: float = 5) -> bool:
        """Whether a publisher on `key` comes to see a subscriber."""
        publisher = self._session.declare_publisher(key)
        return _wait(lambda: bool(publisher.matching_status.matching), seconds)

    def wait_gone(self, zid: str, seconds: float = 10) -> bool:
        """Whether the link to `zid` ends; all that came over it has been read by then."""

        def gone() -> bool:
            while (event := self._links.try_recv()) is not None:
                if event.kind == zenoh.SampleKind.DELETE and str(event.link.zid) == zid:
                    return True
            return False

        return _wait(gone, seconds)

    def identity(self, zid: str, seconds: float = 5) -> str | None:
        """Whom the certificate of the link to `zid` names, once there is one."""
        found: dict[str, str | None] = {}

        def seen() -> bool:
            found.update({str(link.zid): link.auth_identifier for link in self._session.info.links()})
            return zid in found

        _wait(seen, seconds)
        return found[zid]

    def leave(self) -> None:
        """Closes the session; another may be opened."""
        if self._session is not None:
            self._session.close()

    def _keep(self, subscriber: Any) -> None:
        self._kept.append(subscriber)
        self._rings.append(subscriber.handler)


def _wait(done: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not (seen := done()) and time.monotonic() < end:
        time.sleep(POLL_S)
    return seen


def main() -> None:
    actor = Actor()
    try:
        for line in sys.stdin:
            name, *arguments = json.loads(line)
            command: Callable[..., Any] = getattr(actor, name)
            try:
                answer = {"ok": command(*arguments)}
            except Exception as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            print(json.dumps(answer), flush=True)
    finally:
        actor.leave()


if __name__ == "__main__":
    main()
