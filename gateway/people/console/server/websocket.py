"""The WebSocket of a page with a session: aiohttp's, with bounds on what a page sends.

It buffers little for a page that reads slowly, since the newest state waits behind what is buffered.
"""

import asyncio
import socket
import time
from contextlib import suppress
from typing import Final

from aiohttp import WSMsgType, web

from gateway.allowance import Allowance
from gateway.people.console.pages.page_messages import MAX_MESSAGE_BYTES
from gateway.people.console.pages.page_tasks import EndError
from gateway.people.console.server.auth import SUBPROTOCOL
from gateway.people.console.server.listener import CLOSING_S, UNSENT_BYTES

FRAMES_A_SECOND: Final = 300
"""From one page, control frames too. A page that drives each leg by a message of its own sends 120 setpoints."""
FRAMES_AT_ONCE: Final = 150
"""A page whose network stalled for a second sends at once what waited."""
PING_S: Final = 20.0
"""A page that has sent nothing for this long is pinged, and closed after half as long again."""
SEND_S: Final = 5.0
"""A page that does not read for this long, while its socket is full, is closed."""
REASON_BYTES: Final = 123
"""The room for it in a close frame."""


class ClosedError(Exception):
    """The WebSocket is closed, or closing."""


class WebSocket(web.WebSocketResponse):
    """One page's, until it is closed by either side."""

    def __init__(self) -> None:
        super().__init__(
            timeout=CLOSING_S,
            autoping=False,  # so that pings are counted
            heartbeat=PING_S,
            protocols=[SUBPROTOCOL],
            compress=False,
            max_msg_size=MAX_MESSAGE_BYTES,
            writer_limit=0,  # each message waits until there is room for it
        )
        self._frames = Allowance(FRAMES_A_SECOND, FRAMES_AT_ONCE)

    async def begin(self, request: web.BaseRequest) -> None:
        """Answer the request."""
        await self.prepare(request)
        connection: socket.socket = self.get_extra_info("socket")
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # not on Windows
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)

    async def take(self) -> str:
        """The next text message. Raises ClosedError, and EndError for what no page sends."""
        while True:
            message = await self.receive()
            await asyncio.sleep(0)  # lets the other pages go first
            if message.type not in (WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.PING, WSMsgType.PONG):
                raise ClosedError
            if not self._frames.take(time.monotonic_ns()):
                raise EndError(f"more than {FRAMES_A_SECOND} messages a second")
            if message.type is WSMsgType.BINARY:
                raise EndError("a page sends text")
            if message.type is WSMsgType.TEXT:
                return str(message.data)
            if message.type is WSMsgType.PING:
                await self.pong(message.data)

    async def put(self, text: str) -> None:
        """Send a message, and wait for room for the next one. Raises ClosedError, TimeoutError."""
        try:
            async with asyncio.timeout(SEND_S):
                await self.send_str(text)
        except ConnectionError as error:
            raise ClosedError from error

    async def end(self, code: int, reason: str) -> None:
        """Close it with this reason, cut to what fits; a page that does not read gets none."""
        with suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(CLOSING_S):
                await self.close(code=code, message=reason.encode()[:REASON_BYTES].decode(errors="ignore").encode())
