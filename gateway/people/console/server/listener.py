"""Takes connections, TLS, HTTP requests and pages' WebSockets: aiohttp, within bounds.

It runs on the loop that serves the pages, so what somebody without a session costs is bounded: reads, bytes and time of
a connection, which has one request and no body; connections at once; and connections a second, of which the kernel
queues further ones, or drops them.
"""

import asyncio
import logging
import socket
import ssl
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Final, Literal, cast

from aiohttp import WSMsgType, web
from multidict import MultiMapping
from yarl import URL

from gateway.people.console.pages.page_messages import MAX_MESSAGE_BYTES
from gateway.people.console.pages.page_tasks import EndError
from gateway.people.console.server.auth import CAMERA
from gateway.people.console.server.sessions import Entry
from gateway.people.console.server.site import UNSENT_BYTES
from gateway.rate_limit import NS_PER_S, RateLimit

MAX_CONNECTIONS: Final = 96
"""Most connections without WebSockets. Each takes a descriptor, and 100 kB with TLS; a browser opens six for files."""
CONNECTIONS_A_SECOND: Final = 50
"""Connections accepted a second. With TLS each takes some 2 ms of the loop: a flood takes a tenth of a processor."""
CONNECTIONS_AT_ONCE: Final = 16
"""Connections without a pause: two browsers that open a page."""
UNKNOWN_BYTES: Final = 65_536
"""Bytes of a connection without a session. A request has 1 to 8 kB: on loopback it contains all consoles' cookies."""
READ_BYTES: Final = 1024
"""Bytes that each read counts in addition. A handshake and a request take five reads, on a bad network some more."""
BYTES_A_SECOND: Final = 262_144
"""Bytes of a connection with a session. A page that drives each leg by its own message sends 40 000, in 120 reads."""
UNKNOWN_S: Final = 5.0
"""Limit for the handshake, the request and its answer."""
SIGNED_IN_S: Final = 30.0
"""Limit for a file of 150 kB or a picture, with a session."""
CLOSING_S: Final = 1.0
"""The longest wait for the peer to confirm that a connection is closed."""
ACCEPT_AGAIN_S: Final = 1.0
"""Pause after a connection could not be accepted for lack of descriptors or memory: meanwhile Stops have these."""
FRAMES_A_SECOND: Final = 300
"""Frames from one page, control frames too. A page that drives each leg by its own message sends 120 setpoints."""
FRAMES_AT_ONCE: Final = 150
"""A page whose network stalled for a second sends the waiting frames at once."""
PING_S: Final = 20.0
"""A page that has sent nothing for this long is pinged, and closed after half as long again."""
SEND_S: Final = 5.0
"""A page that does not read for this long, while its socket is full, is closed."""

_log: Final = logging.getLogger(__name__)
_silent: Final = logging.Logger("aiohttp", logging.CRITICAL + 1)
"""Silences aiohttp's log: a traceback for each malformed request."""


class Connection(web.RequestHandler):
    """One connection: aiohttp's protocol with limits on received bytes, and a deadline."""

    def __init__(self, server: web.Server, tls: ssl.SSLContext | None, others: "dict[Connection, None]") -> None:
        """`others`: all open connections, the oldest first; it adds itself while it is open."""
        self._own_loop = asyncio.get_running_loop()
        super().__init__(
            server,
            loop=self._own_loop,
            logger=_silent,
            access_log=None,  # type: ignore[arg-type]  # aiohttp's own way to have none
            lingering_time=0.0,
            auto_decompress=False,  # nobody reads a body
        )
        self.serves: Literal["nobody", "files", "page"] = "nobody"
        """Somebody without a session, or with one what is bounded apart."""
        self._tls = tls
        self._others = others
        self._bytes = RateLimit(1, UNKNOWN_BYTES)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called again once the handshake is over."""
        transport = cast("asyncio.Transport", transport)
        transport.set_write_buffer_limits(high=UNSENT_BYTES)
        if self not in self._others:
            self._others[self] = None
            self._raw = transport
            self._deadline = self._own_loop.call_later(UNKNOWN_S, self.abort)
            self.address = str((transport.get_extra_info("peername") or [""])[0])
            if self._tls is not None:
                transport.pause_reading()
                self._handshake = self._own_loop.create_task(self._begin_tls(transport, self._tls))
                return
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        if self._bytes.take(time.monotonic_ns(), READ_BYTES + len(data)):
            super().data_received(data)
        else:
            self.abort()

    def connection_lost(self, exc: BaseException | None) -> None:
        super().connection_lost(exc)
        self._end()

    def begin(self, serves: Literal["files", "page"], until_s: float | None) -> None:
        """Serve a request that has a session, and abort after `until_s` (None: never)."""
        if self.serves == "nobody":
            self._bytes = RateLimit(BYTES_A_SECOND, BYTES_A_SECOND)
        self.serves = serves
        self._deadline.cancel()
        if until_s is not None:
            self._deadline = self._own_loop.call_later(until_s, self.abort)

    def abort(self) -> None:
        """Close the connection at once, without sending pending data."""
        self._raw.abort()
        self._end()

    async def _begin_tls(self, raw: asyncio.Transport, context: ssl.SSLContext) -> None:
        with suppress(OSError):  # also ssl.SSLError: no handshake
            transport = await self._own_loop.start_tls(raw, self, context, server_side=True)
            if transport is not None and not raw.is_closing():
                return self.connection_made(transport)
        return self.abort()

    def _end(self) -> None:
        self._deadline.cancel()
        self._others.pop(self, None)


class HttpListener:
    """Serves sockets, on the loop of the pages."""

    def __init__(
        self,
        tls: ssl.SSLContext | None,
        answer: Callable[[URL, MultiMapping[str]], Awaitable[web.Response | Entry]],
        serve_page: Callable[[web.BaseRequest, Entry], Awaitable[web.StreamResponse]],
    ) -> None:
        """`answer` is `Auth.answer`; `serve_page` answers a page's WebSocket, and its requests for pictures."""
        self._tls = tls
        self._find = answer
        self._serve_page = serve_page
        self._server = web.Server(self._answer)
        self._open: dict[Connection, None] = {}
        self._allowance = RateLimit(CONNECTIONS_A_SECOND, CONNECTIONS_AT_ONCE)

    async def serve(self, listening: Sequence[socket.socket]) -> None:
        """Accept connections until it is cancelled."""
        await asyncio.gather(*(self._serve(each) for each in listening))

    async def _serve(self, listening: socket.socket) -> None:
        listening.setblocking(False)
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(self._allowance.wait_ns(time.monotonic_ns()) / NS_PER_S)
            try:
                accepted, _ = await loop.sock_accept(listening)
                self._allowance.take(time.monotonic_ns())
                if len(self._who("nobody", "files")) >= MAX_CONNECTIONS:
                    # End the oldest of the address that has most places, first without a session.
                    rivals = self._who("nobody") or self._who("files")
                    have = Counter(each.address for each in rivals)
                    next(each for each in rivals if have[each.address] == max(have.values())).abort()
                await loop.connect_accepted_socket(lambda: Connection(self._server, self._tls, self._open), accepted)
            except Exception as error:  # for want of descriptors or memory
                _log.warning("a connection could not be accepted: %s; all without a session are ended", error)
                for each in self._who("nobody"):
                    each.abort()
                await asyncio.sleep(ACCEPT_AGAIN_S)

    def _who(self, *serves: str) -> list[Connection]:
        return [each for each in self._open if each.serves in serves]

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        connection = cast("Connection", request.protocol)
        try:
            found = await self._find(request.rel_url, request.headers)
            if isinstance(found, Entry) and request.path.startswith(CAMERA):
                connection.begin("files", SIGNED_IN_S)
                return await self._serve_page(request, found)
            if isinstance(found, Entry):
                connection.begin("page", None)
                try:
                    return await self._serve_page(request, found)
                finally:
                    connection.begin("page", CLOSING_S)
        except Exception:
            _log.exception("a request could not be answered")
            raise
        if found.keep_alive is None:
            connection.begin("files", SIGNED_IN_S)
        return found


class WebSocket(web.WebSocketResponse):
    """One page's. It buffers little for a page that reads slowly: the newest state waits behind what is buffered."""

    def __init__(self) -> None:
        super().__init__(
            timeout=CLOSING_S,
            autoping=False,  # so that pings are counted
            heartbeat=PING_S,
            compress=False,
            max_msg_size=MAX_MESSAGE_BYTES,
            writer_limit=0,  # each message waits until there is room for it
        )
        self._frames = RateLimit(FRAMES_A_SECOND, FRAMES_AT_ONCE)

    async def take(self) -> str:
        """Return the next text message. Raises ConnectionError if closed, EndError for data that no page sends."""
        while True:
            message = await self.receive()
            await asyncio.sleep(0)  # lets the other pages go first
            if message.type not in (WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.PING, WSMsgType.PONG):
                raise ConnectionResetError
            if not self._frames.take(time.monotonic_ns()):
                raise EndError(f"more than {FRAMES_A_SECOND} messages a second")
            if message.type is WSMsgType.BINARY:
                raise EndError("a page sends text")
            if message.type is WSMsgType.TEXT:
                return str(message.data)
            if message.type is WSMsgType.PING:
                await self.pong(message.data)

    async def put(self, text: str) -> None:
        """Send a message, and wait for room for the next one. Raises ConnectionError, TimeoutError."""
        async with asyncio.timeout(SEND_S):
            await self.send_str(text)

    async def end(self, code: int, reason: str) -> None:
        """Close it with this reason, at most 123 characters; a page that does not read gets none."""
        with suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(CLOSING_S):
                await self.close(code=code, message=reason.encode("ascii", "replace")[:123])
