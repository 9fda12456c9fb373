"""The WebSocket of a page with a session, on the loop that serves all pages.

It reads little at a time, so a page that floods delays the others by little. It buffers little for a page that reads
slowly, since the newest state waits behind what is buffered.
"""

import asyncio
import socket
import ssl
import time
from collections import deque
from contextlib import suppress
from typing import Final, cast

from websockets.exceptions import InvalidState, ProtocolError
from websockets.frames import Frame, Opcode
from websockets.server import ServerProtocol

from gateway.allowance import Allowance
from gateway.people.console.server.tls import Layer

UNSENT_BYTES: Final = 4096
"""That wait for one page, in this process and as much in the kernel: some five states."""
PAGE_READ_BYTES: Final = 1024
"""Read from one page before the others: some ten messages, or 170 of the smallest frames (2.5 ms)."""
SLICE_BYTES: Final = 256
"""Parsed before the frames in it are counted."""
FRAMES_A_SECOND: Final = 300
"""From one page, control frames too. A page that drives each leg by a message of its own sends 120 setpoints."""
FRAMES_AT_ONCE: Final = 150
"""A page whose network stalled for a second sends at once what waited."""
BYTES_A_SECOND: Final = 131_072
"""From one page; one that drives each leg by a message of its own sends 40 000."""
PING_S: Final = 20.0
"""A page that has sent nothing for so long is pinged, and closed after as long again."""
CLOSING_S: Final = 1.0
"""How long a page has to receive and confirm the reason why it is closed."""
POLICY_VIOLATION: Final = 1008
NOT_TEXT: Final = "a page sends text"
TOO_MUCH: Final = f"more than {FRAMES_A_SECOND:g} messages a second, or {BYTES_A_SECOND:g} bytes"
REASON_BYTES: Final = 123
"""The room for it in a close frame."""


class ClosedError(Exception):
    """The WebSocket is closed, or closing."""


class Quiet:
    """A silent page is pinged after PING_S, and gone after as long again. Pure: `now_s` never goes back.

    >>> quiet = Quiet(0.0)
    >>> quiet.received(5.0)
    >>> [(quiet.must_ask(now_s), quiet.is_gone(now_s), quiet.due_s) for now_s in (24.0, 25.0, 45.0)]
    [(False, False, 25.0), (True, False, 45.0), (False, True, 45.0)]
    """

    def __init__(self, now_s: float) -> None:
        self.received(now_s)

    def received(self, now_s: float) -> None:
        """The page has sent something, a pong too."""
        self._received_s = now_s
        self._asked = False

    @property
    def due_s(self) -> float:
        """When to ping, or to give up, in the time of `now_s`."""
        return self._received_s + PING_S * (2 if self._asked else 1)

    def must_ask(self, now_s: float) -> bool:
        """Whether to ping the page now; true once for each silence."""
        asks = not self._asked and now_s >= self.due_s
        self._asked = self._asked or asks
        return asks

    def is_gone(self, now_s: float) -> bool:
        """Whether it was pinged, and has sent nothing."""
        return self._asked and now_s >= self.due_s


class WebSocket(asyncio.BufferedProtocol):
    """One connection, whose request is answered with 101 in `protocol`."""

    def __init__(self, layer: Layer, protocol: ServerProtocol) -> None:
        self._layer = layer
        self._protocol = protocol
        self._buffer = bytearray(PAGE_READ_BYTES)
        self._loop = asyncio.get_running_loop()
        self._frames = Allowance(FRAMES_A_SECOND, FRAMES_AT_ONCE)
        self._bytes = Allowance(BYTES_A_SECOND, BYTES_A_SECOND)
        self._quiet = Quiet(self._loop.time())
        self._parts: list[bytes] = []
        self._texts: deque[str] = deque()
        self._there = asyncio.Event()
        self._writable = asyncio.Event()
        self._writable.set()
        self._timer: asyncio.TimerHandle | None = None
        self.closed = asyncio.Event()
        """Set once the connection has ended, by either side."""

    async def receive(self) -> str:
        """The next text message. Raises ClosedError."""
        while not self._texts:
            self._raise_if_closed()
            self._there.clear()
            await self._there.wait()
        text = self._texts.popleft()
        if not self._texts and not self._transport.is_closing():
            self._transport.resume_reading()
        return text

    async def send(self, text: str) -> None:
        """Send a message once there is room for it. Raises ClosedError."""
        await self._writable.wait()
        self._raise_if_closed()
        self._protocol.send_text(text.encode())
        self._flush()

    def close(self, code: int, reason: str) -> None:
        """Close it with this reason, cut to what fits. What the page still sends is ignored."""
        if self._transport.is_closing():
            return
        with suppress(InvalidState, ProtocolError):  # already closing
            self._protocol.send_close(code, reason.encode()[:REASON_BYTES].decode(errors="ignore"))
        self._flush()
        self._give_up_in(CLOSING_S)
        self._there.set()
        self._transport.resume_reading()  # to receive the page's own close

    def abort(self) -> None:
        """End it at once, without a reason."""
        self._transport.abort()

    # ---- asyncio's

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=UNSENT_BYTES)
        connection: socket.socket = transport.get_extra_info("socket")
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # not on Windows
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
        self._timer = self._loop.call_at(self._quiet.due_s, self._look)
        self._flush()
        self._take_events()

    def get_buffer(self, sizehint: int) -> bytearray:
        del sizehint
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._quiet.received(self._loop.time())
        if not self._bytes.take(time.monotonic_ns(), nbytes):
            self._flooded()
            return
        try:
            data = self._layer.receive(bytes(self._buffer[:nbytes]))
        except (EOFError, ssl.SSLError):
            self._transport.abort()
            return
        for start in range(0, len(data), SLICE_BYTES):
            self._protocol.receive_data(data[start : start + SLICE_BYTES])
            if not self._take_events():
                return

    def eof_received(self) -> None:
        self._transport.close()

    def pause_writing(self) -> None:
        self._writable.clear()

    def resume_writing(self) -> None:
        self._writable.set()

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        if self._timer is not None:
            self._timer.cancel()
        self.closed.set()
        self._writable.set()
        self._there.set()

    # ---- inside

    def _take_events(self) -> bool:
        """Take the parsed frames; returns whether further bytes may be parsed."""
        frames = self._protocol.events_received()
        if frames and not self._frames.take(time.monotonic_ns(), len(frames)):
            self._flooded()
            return False
        for frame in frames:
            if isinstance(frame, Frame) and not self._take(frame):
                return False
        self._flush()
        return not self._transport.is_closing()

    def _take(self, frame: Frame) -> bool:
        if frame.opcode is Opcode.BINARY:
            self.close(POLICY_VIOLATION, NOT_TEXT)
            return False
        if frame.opcode in (Opcode.TEXT, Opcode.CONT) and self._protocol.close_sent is None:
            self._parts.append(bytes(frame.data))
            if frame.fin:
                data, self._parts = b"".join(self._parts), []
                try:
                    self._texts.append(data.decode())
                except UnicodeDecodeError:
                    self.close(1007, NOT_TEXT)
                    return False
                self._there.set()
                self._transport.pause_reading()  # until `receive` has returned this
        return True

    def _flush(self) -> None:
        """Send what the protocol and TLS have to send."""
        if self._transport.is_closing():
            return
        self._transport.write(self._layer.to_send())
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(self._layer.encrypt(data))
            else:
                self._transport.close()  # both sides have sent a close frame
                self._give_up_in(CLOSING_S)

    def _flooded(self) -> None:
        """Close it with the reason, and read nothing more, since each read costs time."""
        self._texts.clear()
        self._protocol.fail(POLICY_VIOLATION, TOO_MUCH)
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(self._layer.encrypt(data))
        self._transport.pause_reading()
        self._give_up_in(CLOSING_S)
        self._there.set()

    def _raise_if_closed(self) -> None:
        if self._transport.is_closing() or self._protocol.close_sent is not None:
            raise ClosedError

    def _look(self) -> None:
        now_s = self._loop.time()
        if self._quiet.is_gone(now_s):
            self._transport.abort()
            return
        if self._quiet.must_ask(now_s):
            self._protocol.send_ping(b"")
            self._flush()
        self._timer = self._loop.call_at(self._quiet.due_s, self._look)

    def _give_up_in(self, delay_s: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(delay_s, self._transport.abort)
