"""Takes connections, TLS and HTTP requests, and answers them, on a thread with a loop of its own.

The pages' loop never waits for it, and is given a connection only once it is the WebSocket of a page with a session.
Until then the cost of a connection is bounded, and so is their number:

| per connection | so many reads and bytes, one deadline for everything, one request, no body |
| at once        | so many places; a further connection ends the oldest of the address that has most of them |
| a second       | so many connections; the kernel queues the others, or drops them |

Both threads share the interpreter, so each time that the pages' loop returns from the kernel it may wait for this
thread, for `SWITCH_INTERVAL_S`. A press of STOP ALL returns from the kernel some ten times.
"""

import asyncio
import logging
import socket
import ssl
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from websockets.http11 import Request
from websockets.server import ServerProtocol
from websockets.typing import Subprotocol

from gateway.allowance import NS_PER_S, Allowance
from gateway.host.realtime import SWITCH_INTERVAL_S
from gateway.people.console.pages.page_messages import MAX_MESSAGE_BYTES
from gateway.people.console.server.auth import SUBPROTOCOL, Auth, SignedIn
from gateway.people.console.server.tls import Layer, Tls

MAX_UNKNOWN: Final = 64
"""Connections without a session; each takes one descriptor, and some 100 kB with TLS."""
MAX_SIGNED_IN: Final = 32
"""Connections with a session, which load the page's files: a browser opens six."""
CONNECTIONS_A_SECOND: Final = 50
"""With TLS each takes some 2 ms of this thread, so a flood takes a tenth of a processor."""
CONNECTIONS_AT_ONCE: Final = 64
"""Without a pause: a page loads 30 files."""
READS: Final = 40
"""Of one connection: a handshake and a request take five, on a bad network some more."""
REQUEST_READ_BYTES: Final = 4096
REQUEST_BYTES: Final = 32_768
"""Of one connection: a request has 1 to 8 kB, since on loopback all consoles' cookies come with it."""
UNKNOWN_S: Final = 5.0
"""For the handshake, the request and its answer."""
SIGNED_IN_S: Final = 30.0
"""For a file of 1.5 MB, with a session."""
ANSWER_PART_BYTES: Final = 65_536
"""Encrypted at a time, which is what waits in memory for one connection."""
ACCEPT_AGAIN_S: Final = 1.0
"""After a connection could not be accepted, for want of descriptors or memory: meanwhile Stops have them."""

_log: Final = logging.getLogger(__name__)


@dataclass(frozen=True)
class Admitted:
    """A page's WebSocket with a session: its request is answered in `protocol`, but the answer is not sent yet."""

    connection: socket.socket
    layer: Layer
    protocol: ServerProtocol
    session: SignedIn


@dataclass(eq=False)
class _Visit:
    """One connection, until it is answered or handed over."""

    connection: socket.socket
    address: str
    layer: Layer
    protocol: ServerProtocol
    task: "asyncio.Task[None] | None" = None
    reads: int = 0
    received: int = 0
    handed_over: bool = False


@dataclass(eq=False)
class _Places:
    """The connections that have one, the oldest first."""

    most: int
    visits: dict[_Visit, None] = field(default_factory=dict)

    def add(self, visit: _Visit) -> None:
        """Give it a place; if there is none, end the oldest connection of the address that has most."""
        if len(self.visits) >= self.most:
            have = Counter(other.address for other in self.visits)
            largest = max(have.values())
            self._end(next(other for other in self.visits if have[other.address] == largest))
        self.visits[visit] = None

    def end_all(self) -> None:
        """End all: a Stop needs what they hold."""
        for visit in list(self.visits):
            self._end(visit)

    def _end(self, visit: _Visit) -> None:
        del self.visits[visit]
        if visit.task is not None:
            visit.task.cancel()

    def discard(self, visit: _Visit) -> None:
        self.visits.pop(visit, None)


class HttpListener:
    """Serves on a thread of its own, from `start` on."""

    def __init__(
        self,
        listening: Sequence[socket.socket],
        context: ssl.SSLContext | None,
        auth: Auth,
        admit: Callable[[Admitted], None],
    ) -> None:
        """`admit` is called on this thread."""
        self._listening = listening
        self._context = context
        self._auth = auth
        self._admit = admit
        self._unknown = _Places(MAX_UNKNOWN)
        self._signed_in = _Places(MAX_SIGNED_IN)
        self._allowance = Allowance(CONNECTIONS_A_SECOND, CONNECTIONS_AT_ONCE)

    def start(self) -> None:
        """Begin to accept connections, on the new thread."""
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        threading.Thread(target=self._run, name="listener", daemon=True).start()

    def _run(self) -> None:
        while True:
            try:
                asyncio.run(self.serve())
            except Exception:
                _log.exception("new connections cannot be served; trying again")

    async def serve(self) -> None:
        """Accept connections until it is cancelled."""
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(report)
        await asyncio.gather(*(self._serve(loop, each) for each in self._listening))

    async def _serve(self, loop: asyncio.AbstractEventLoop, listening: socket.socket) -> None:
        listening.setblocking(False)
        while True:
            await asyncio.sleep(self._allowance.wait_ns(time.monotonic_ns()) / NS_PER_S)
            try:
                connection, address = await loop.sock_accept(listening)
            except OSError as error:
                _log.warning("a connection could not be accepted: %s; all without a session are ended", error)
                self._unknown.end_all()
                await asyncio.sleep(ACCEPT_AGAIN_S)
                continue
            self._allowance.take(time.monotonic_ns())
            self._begin(connection, str(address[0]))

    def _begin(self, connection: socket.socket, address: str) -> None:
        layer = Layer() if self._context is None else Tls(self._context)
        protocol = ServerProtocol(subprotocols=[Subprotocol(SUBPROTOCOL)], max_size=MAX_MESSAGE_BYTES, logger=_silent)
        visit = _Visit(connection, address, layer, protocol)
        self._unknown.add(visit)
        visit.task = asyncio.get_running_loop().create_task(self._visit(visit))
        visit.task.add_done_callback(partial(self._end, visit))

    def _end(self, visit: _Visit, task: "asyncio.Task[None]") -> None:
        """Release what it holds, also if it was cancelled before it began."""
        self._unknown.discard(visit)
        self._signed_in.discard(visit)
        if not visit.handed_over:
            visit.connection.close()
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("a connection ended by a fault: %r", error)

    async def _visit(self, visit: _Visit) -> None:
        try:
            async with asyncio.timeout(UNKNOWN_S) as deadline:
                request = await self._request(visit)
                if request is not None:
                    await self._answer(visit, request, deadline)
        except (OSError, EOFError):
            pass  # closed, or too slow (TimeoutError is an OSError, and so is ssl.SSLError)

    async def _request(self, visit: _Visit) -> Request | None:
        """The request; None if it was malformed, and is answered. Raises OSError, EOFError."""
        loop = asyncio.get_running_loop()
        while visit.reads < READS and visit.received < REQUEST_BYTES:
            data = await loop.sock_recv(visit.connection, REQUEST_READ_BYTES)
            if not data:
                raise EOFError
            visit.reads += 1
            visit.received += len(data)
            try:
                received = visit.layer.receive(data)
            finally:
                await self._send(visit, visit.layer.to_send())
            if received:
                visit.protocol.receive_data(received)
                for event in visit.protocol.events_received():
                    if visit.protocol.eof_sent:
                        raise EOFError  # what follows the request is no frame
                    if isinstance(event, Request):
                        return event
                if await self._send_answer(visit):
                    return None
        raise EOFError

    async def _answer(self, visit: _Visit, request: Request, deadline: asyncio.Timeout) -> None:
        answer = self._auth.answer(request)
        if isinstance(answer, SignedIn):
            response = visit.protocol.accept(request)
            visit.protocol.send_response(response)
            if response.status_code == 101:
                visit.handed_over = True
                self._admit(Admitted(visit.connection, visit.layer, visit.protocol, answer))
                return
        else:
            if answer.is_for_session:
                self._unknown.discard(visit)
                self._signed_in.add(visit)
                deadline.reschedule(asyncio.get_running_loop().time() + SIGNED_IN_S)
            visit.protocol.send_response(answer.response)
        await self._send_answer(visit)

    async def _send_answer(self, visit: _Visit) -> bool:
        """Send what the protocol has to send; returns whether there was something."""
        parts = visit.protocol.data_to_send()
        for part in parts:
            for start in range(0, len(part), ANSWER_PART_BYTES):
                await self._send(visit, visit.layer.encrypt(part[start : start + ANSWER_PART_BYTES]))
        if parts:
            with suppress(OSError):
                visit.connection.shutdown(socket.SHUT_WR)
        return bool(parts)

    async def _send(self, visit: _Visit, data: bytes) -> None:
        if data:
            await asyncio.get_running_loop().sock_sendall(visit.connection, data)


def report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log one line as asyncio's exception handler; its own would render a traceback on the loop."""
    del loop
    _log.error("%s: %r", context.get("message"), context.get("exception"))


_silent: Final = logging.getLogger("gateway.people.console.websockets")
"""The library's log of each connection."""
_silent.setLevel(logging.CRITICAL + 1)
_silent.propagate = False
