"""The console as a user starts it, and a page of it: what a browser sends and hears, without the browser."""

import hashlib
import itertools
import json
import os
import ssl
import time
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

import httpx
from websockets.exceptions import InvalidMessage
from websockets.sync.client import ClientConnection, connect

from gateway.people.console.server.auth import proof
from gateway.people.console.server.sessions import Sessions
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, free_port
from tests.support.waiting import Closing

LINK: Final = "The console is at "
LATE_S: Final = 90.0
"""How long is waited for what takes milliseconds: a busy machine must not fail a test."""
TRIES: Final = 10


class Console(Closing):
    """A running console; its sessions are kept in `folder`. It listens when the constructor returns."""

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        address: str = "127.0.0.1",
        port: int | None = None,
        prefix: Sequence[str] = (),
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.port = free_port() if port is None else port
        self.listen = ("--listen", f"{address}:{self.port}")
        self.env = {**os.environ, "STATE_DIRECTORY": str(folder), **(env or {})}
        self._folder = folder
        self.child = Child([*prefix, *COMMAND, "console", *self.listen, *arguments], self.env)
        self.url = self.child.wait_for_output(LINK).removeprefix(LINK).strip()

    def new_link(self) -> str:
        """Return a new link, as `--link` prints it."""
        return Sessions(self._folder, self.port).new_link()

    def sign_in(self, link: str = "") -> "SignedIn":
        return sign_in(link or self.new_link())

    def get(self, path: str = "/session", **headers: str) -> httpx.Response:
        """Return a request with these headers."""
        return httpx.get(self.url + path, headers=headers)

    def run(self, *arguments: str) -> Child:
        """Run `hexapod-gateway console …` with the same sessions, and wait for its end."""
        child = Child([*COMMAND, "console", *self.listen, *arguments], self.env)
        child.wait()
        child.close()
        return child

    def page(self, session: "SignedIn") -> "Page":
        return Page(self.url, session)

    def close(self) -> None:
        self.child.close()


class SignedIn(NamedTuple):
    """A browser's part of a session: the cookie, as `name=value`, and the page's key."""

    cookie: str
    key: str

    def shown(self, url: str, verify: ssl.SSLContext | None = None) -> str:
        """Return what its WebSocket's address carries once the console has answered."""
        answer = httpx.get(f"{url}/session?nonce=mine", headers=self.headers, verify=verify or True)
        found = answer.json() if answer.status_code == 200 else {"nonce": ""}
        nonce, key_sha256 = found["nonce"], hashlib.sha256(self.key.encode()).hexdigest()
        return f"nonce={nonce}&proof={proof(key_sha256, f'page {nonce}')}"

    @property
    def headers(self) -> dict[str, str]:
        return {"Cookie": self.cookie}


NOBODY: Final = SignedIn("", "")


def opened(url: str, session: SignedIn, verify: ssl.SSLContext | None = None) -> ClientConnection:
    """Open a page's WebSocket. Dial again, as a page does, if a busy machine took longer than the console's 5 s."""

    def dial() -> ClientConnection:
        return connect(
            f"{url.replace('http', 'ws', 1)}/ws?{session.shown(url, verify)}",
            additional_headers={"Cookie": session.cookie, "Origin": url},
            ssl=verify,
            compression=None,
            max_size=2**20,
            max_queue=None,  # a full queue holds up the end of the connection: 10 s
        )

    for _ in range(TRIES - 1):
        with suppress(EOFError, InvalidMessage):
            return dial()
    return dial()


def sign_in(link: str, verify: ssl.SSLContext | bool = True) -> SignedIn:
    answer = httpx.get(link, verify=verify)
    assert answer.status_code == 303, answer.text
    path, _, key = answer.headers["location"].partition("#")
    assert path == "/enter.html"
    return SignedIn(answer.headers["set-cookie"].partition(";")[0], key)


class Page(Closing):
    """A page's WebSocket. What it hears is read when it is waited for."""

    def __init__(self, url: str, session: SignedIn, verify: ssl.SSLContext | None = None) -> None:
        self._ids = itertools.count(1)
        self.heard: list[str] = []
        """Every message so far, as it came."""
        self._kept: defaultdict[str, deque[dict[str, Any]]] = defaultdict(deque)
        with ExitStack() as stack:
            self.socket: ClientConnection = stack.enter_context(opened(url, session, verify))
            self.hello = self.wait("hello")
            self.send(type="alive", now_ms=self.now_ms())
            self._stack = stack.pop_all()

    def now_ms(self) -> float:
        return time.perf_counter() * 1000

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def wait(
        self, kind: str, fits: Callable[[dict[str, Any]], bool] = lambda _: True, timeout_s: float = LATE_S
    ) -> dict[str, Any]:
        """Return the next message of that kind that fits. Others are kept for later, except for states."""
        kept = self._kept[kind]
        while kept:
            if fits(found := kept.popleft()):
                return found
        end_s = time.monotonic() + timeout_s
        while True:
            text = self.socket.recv(timeout=max(0.0, end_s - time.monotonic()))
            self.heard.append(str(text))
            message: dict[str, Any] = json.loads(text)
            if message["type"] == kind and fits(message):
                return message
            if message["type"] not in (kind, "state"):
                self._kept[message["type"]].append(message)

    def answer(self, kind: str, number: int) -> dict[str, Any]:
        return self.wait(kind, lambda message: message["id"] == number)

    def state(self, fits: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        return dict(self.wait("state", lambda message: fits(message["state"]))["state"])

    def event(self, kind: str, *, since: datetime) -> dict[str, Any]:
        """Return the next event of this kind that happened since then; a page begins with older ones."""

        def fits(message: dict[str, Any]) -> bool:
            event = message["event"]
            return event["kind"] == kind and datetime.fromisoformat(event["time"]) >= since

        return dict(self.wait("event", fits)["event"])

    def ask(self, key: str, payload: Mapping[str, Any]) -> dict[str, Any]:
        """Ask for a command. Return the whole answer."""
        return self._ask(type="command", key=key, payload=payload)

    def put(self, key: str, payload: Mapping[str, Any]) -> None:
        self.send(type="command", key=key, payload=payload, sent_ms=self.now_ms())

    def stop_all(self) -> dict[str, Any]:
        """Send STOP ALL, and return the message that confirms it."""
        number = next(self._ids)
        self.send(type="stop_all", id=number)
        return self.wait("stop", lambda message: message["id"] == number and message["answered"])

    def reset(self, estop: int) -> dict[str, Any]:
        return self._ask(type="reset", estop=estop)

    def _ask(self, **message: Any) -> dict[str, Any]:
        """Return the answer. Ask again, as a person does, if a busy machine delayed the question too long."""
        for _ in range(TRIES):
            number = next(self._ids)
            self.send(id=number, sent_ms=self.now_ms(), **message)
            answer = self.answer("ack", number)
            if answer["ack"] is None or answer["ack"].get("reason") != "stale":
                break
        return answer

    def lease(self, do: str) -> dict[str, Any]:
        """Request the lease, or renew or release it. Return the answer; ask again if the gateway gave none in time."""
        for _ in range(TRIES):
            number = next(self._ids)
            self.send(type="lease", id=number, do=do)
            answer = self.answer("lease", number)
            if "accepted" in answer:
                break
        return answer

    def close(self) -> None:
        self._stack.close()
