"""Takes connections, TLS and HTTP requests, and answers them: aiohttp, within bounds.

It runs on the loop that serves the pages, so what somebody without a session costs is bounded:

| per connection | so many reads and bytes, one deadline for everything, one request, no body |
| at once        | so many places; a further connection ends the oldest of the address that has most of them |
| a second       | so many connections; the kernel queues the others, or drops them |
"""

import asyncio
import logging
import socket
import ssl
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, cast

from aiohttp import web
from multidict import MultiMapping

from gateway.allowance import NS_PER_S, Allowance
from gateway.people.console.server.auth import SignedIn

MAX_UNKNOWN: Final = 64
"""Connections without a session; each takes one descriptor, and some 100 kB with TLS."""
MAX_SIGNED_IN: Final = 32
"""Connections with a session, which load the page's files: a browser opens six."""
CONNECTIONS_A_SECOND: Final = 50
"""With TLS each takes some 2 ms of the loop, so a flood takes a tenth of a processor."""
CONNECTIONS_AT_ONCE: Final = 16
"""Without a pause: two browsers that open a page."""
READS: Final = 40
"""Of one connection without a session: a handshake and a request take five, on a bad network some more."""
REQUEST_BYTES: Final = 32_768
"""Of one: a request has 1 to 8 kB, since on loopback all consoles' cookies come with it."""
BYTES_A_SECOND: Final = 131_072
"""Of one with a session; a page that drives each leg by a message of its own sends 40 000."""
UNSENT_BYTES: Final = 4096
"""That wait for one page, in this process and as much in the kernel: some five states."""
UNKNOWN_S: Final = 5.0
"""For the handshake, the request and its answer."""
SIGNED_IN_S: Final = 30.0
"""For a file of 150 kB, with a session."""
CLOSING_S: Final = 1.0
"""The longest wait for the peer to confirm that a connection is closed."""
ACCEPT_AGAIN_S: Final = 1.0
"""After a connection could not be accepted, for want of descriptors or memory: meanwhile Stops have them."""

_log: Final = logging.getLogger(__name__)
_silent: Final = logging.getLogger("gateway.people.console.aiohttp")
"""aiohttp's log: a traceback for each malformed request."""
_silent.setLevel(logging.CRITICAL + 1)
_silent.propagate = False


class Connection(web.RequestHandler):
    """One connection: aiohttp's protocol with bounds on what it receives, and a deadline."""

    def __init__(self, server: web.Server, accepted: socket.socket, address: str, ended: Callable[[Any], None]) -> None:
        """`ended` is called with this connection when it has ended."""
        self._own_loop = asyncio.get_running_loop()
        super().__init__(
            server,
            loop=self._own_loop,
            logger=_silent,
            access_log=None,  # type: ignore[arg-type]  # aiohttp's own way to have none
            keepalive_timeout=SIGNED_IN_S,
            tcp_keepalive=False,
            lingering_time=0.0,
            auto_decompress=False,  # nobody reads a body
        )
        self.address = address
        self.serves: Serves = "nobody"
        self._accepted = accepted
        self._ended = ended
        self._raw: asyncio.Transport | None = None
        self._reads = self._received = 0
        self._bytes = Allowance(BYTES_A_SECOND, BYTES_A_SECOND)
        self._deadline = self._own_loop.call_later(UNKNOWN_S, self.abort)

    async def open(self, context: ssl.SSLContext | None) -> None:
        """Begin with TLS and HTTP."""
        try:
            raw, _ = await self._own_loop.connect_accepted_socket(_Paused, self._accepted)
            self._raw = raw
            raw.set_write_buffer_limits(high=UNSENT_BYTES)
            transport: asyncio.Transport | None = raw
            if context is None:
                raw.set_protocol(self)
            else:
                transport = await self._own_loop.start_tls(
                    raw,
                    self,
                    context,
                    server_side=True,
                    ssl_handshake_timeout=UNKNOWN_S,
                    ssl_shutdown_timeout=CLOSING_S,
                )
            if transport is None or raw.is_closing():
                self.abort()
                return
            transport.set_write_buffer_limits(high=UNSENT_BYTES)
            self.connection_made(transport)
            transport.resume_reading()
        except OSError:  # also ssl.SSLError: no handshake
            self.abort()

    def data_received(self, data: bytes) -> None:
        self._reads += 1
        self._received += len(data)
        if self.serves == "nobody":
            allowed = self._reads <= READS and self._received <= REQUEST_BYTES
        else:
            allowed = self._bytes.take(time.monotonic_ns(), len(data))
        if allowed:
            super().data_received(data)
        else:
            self.abort()

    def connection_lost(self, exc: BaseException | None) -> None:
        super().connection_lost(exc)
        self._end()

    def begin(self, serves: "Serves", until_s: float | None) -> None:
        """Serve a request that has a session, and abort after `until_s` (None: never)."""
        self.serves = serves
        self._deadline.cancel()
        if until_s is not None:
            self._deadline = self._own_loop.call_later(until_s, self.abort)

    def abort(self) -> None:
        """Close the connection at once, without sending what waits."""
        if self._raw is None:
            self._accepted.close()
        else:
            self._raw.abort()
        self._end()

    def _end(self) -> None:
        self._deadline.cancel()
        self._ended(self)


Serves = Literal["nobody", "files", "page"]
"""Whom a connection serves: somebody without a session, or with one what is bounded apart."""


class _Paused(asyncio.Protocol):
    """Reads nothing, until another protocol takes its place."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        cast("asyncio.Transport", transport).pause_reading()


class HttpListener:
    """Serves these sockets. On the loop of the pages."""

    def __init__(
        self,
        listening: Sequence[socket.socket],
        context: ssl.SSLContext | None,
        answer: Callable[[str, str, MultiMapping[str]], web.Response | SignedIn],
        serve_page: Callable[[web.BaseRequest, SignedIn], Awaitable[web.StreamResponse]],
    ) -> None:
        """`answer` is `Auth.answer`; `serve_page` answers a page's WebSocket, and returns once that has ended."""
        self._listening = listening
        self._context = context
        self._find = answer
        self._serve_page = serve_page
        self._server = web.Server(self._answer)
        self._open: dict[Connection, asyncio.Task[None]] = {}
        """The oldest first."""
        self._allowance = Allowance(CONNECTIONS_A_SECOND, CONNECTIONS_AT_ONCE)

    async def serve(self) -> None:
        """Accept connections until it is cancelled."""
        await asyncio.gather(*(self._serve(each) for each in self._listening))

    async def _serve(self, listening: socket.socket) -> None:
        listening.setblocking(False)
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(self._allowance.wait_ns(time.monotonic_ns()) / NS_PER_S)
            try:
                accepted, address = await loop.sock_accept(listening)
                self._allowance.take(time.monotonic_ns())
                self._make_room("nobody", MAX_UNKNOWN)
                connection = Connection(self._server, accepted, str(address[0]), self._discard)
                self._open[connection] = loop.create_task(connection.open(self._context))
            except Exception as error:  # for want of descriptors or memory
                _log.warning("a connection could not be accepted: %s; all without a session are ended", error)
                for each in self._who("nobody"):
                    each.abort()
                await asyncio.sleep(ACCEPT_AGAIN_S)

    def _who(self, serves: Serves) -> list[Connection]:
        return [each for each in self._open if each.serves == serves]

    def _make_room(self, serves: Serves, most: int) -> None:
        """Where there are so many, end the oldest of the address that has most of them."""
        rivals = self._who(serves)
        if len(rivals) >= most:
            have = Counter(each.address for each in rivals)
            next(each for each in rivals if have[each.address] == max(have.values())).abort()

    def _discard(self, connection: Connection) -> None:
        self._open.pop(connection, None)

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        connection = cast("Connection", request.protocol)
        try:
            found = self._find(request.method, request.raw_path, request.headers)
            if isinstance(found, SignedIn):
                connection.begin("page", None)
                try:
                    return await self._serve_page(request, found)
                finally:
                    connection.begin("page", CLOSING_S)
        except Exception:
            _log.exception("a request could not be answered")
            raise
        if found.keep_alive is None:
            if connection.serves != "files":
                self._make_room("files", MAX_SIGNED_IN)
            connection.begin("files", SIGNED_IN_S)
        return found


def report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log one line as asyncio's exception handler; its own would render a traceback on the loop."""
    del loop
    _log.error("%s: %r", context.get("message"), context.get("exception"))


def server_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return a context for TLS 1.2 or newer. Raises OSError or ssl.SSLError if a file cannot be read or is invalid."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION  # in TLS 1.2 a client could demand handshakes without end
    context.load_cert_chain(certificate, key)
    return context
