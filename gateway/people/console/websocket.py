"""The WebSocket of a page that is signed in, on the loop that serves all pages.

It takes little at a time, so that a page that floods delays the others by little, and keeps little for one that reads
slowly: what waits in buffers is the past, and the newest state waits behind it.
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
from gateway.people.console.tls import Layer

SEND_BYTES: Final = 4096
"""Of what waits for one page in this process, and in the kernel besides what is under way: some five states."""
READ_BYTES: Final = 1024
"""Taken from one page before all others have their turn: some ten messages, or 170 of the smallest frames (2.5 ms)."""
SLICE_BYTES: Final = 256
"""Parsed before the frames in it are counted."""
FRAMES_A_SECOND: Final = 300
"""From one page, control frames too. A page that drives each leg by a message of its own sends 120 setpoints."""
FRAMES_AT_ONCE: Final = 150
"""A page whose network stalled for a second sends what waited."""
BYTES_A_SECOND: Final = 131_072
"""From one page; one that drives each leg by a message of its own sends 40 000."""
PING_S: Final = 20.0
"""A page of which nothing comes for so long is asked, and given up after as long again."""
END_S: Final = 1.0
"""How long a page has to take the reason why it is closed, and to say that it did."""
POLICY_VIOLATION: Final = 1008
NOT_TEXT: Final = "a page sends text"
TOO_MUCH: Final = f"more than {FRAMES_A_SECOND:g} messages a second, or {BYTES_A_SECOND:g} bytes"
REASON_BYTES: Final = 123
"""What a WebSocket's close has room for."""


class ClosedError(Exception):
    """The WebSocket is closed."""


class Quiet:
    """A page of which nothing comes is asked after PING_S, and gone after as long again. Pure: `now_s` never goes back.

    >>> quiet = Quiet(0.0)
    >>> quiet.received(5.0)
    >>> [(quiet.must_ask(now_s), quiet.is_gone(now_s), quiet.due_s) for now_s in (24.0, 25.0, 45.0)]
    [(False, False, 25.0), (True, False, 45.0), (False, True, 45.0)]
    """

    def __init__(self, now_s: float) -> None:
        self.received(now_s)

    def received(self, now_s: float) -> None:
        """The page has sent something, an answer too."""
        self._received_s = now_s
        self._asked = False

    @property
    def due_s(self) -> float:
        """When to look again."""
        return self._received_s + PING_S * (2 if self._asked else 1)

    def must_ask(self, now_s: float) -> bool:
        """Whether the page is asked now; true once for each silence."""
        asks = not self._asked and now_s >= self.due_s
        self._asked = self._asked or asks
        return asks

    def is_gone(self, now_s: float) -> bool:
        """Whether it was asked, and has answered nothing."""
        return self._asked and now_s >= self.due_s


class WebSocket(asyncio.BufferedProtocol):
    """One connection, whose request has been answered with 101 in `protocol`."""

    def __init__(self, layer: Layer, protocol: ServerProtocol) -> None:
        self._layer = layer
        self._protocol = protocol
        self._buffer = bytearray(READ_BYTES)
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
        """Set once the connection has ended, whoever ended it."""

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
        """Send a message, once there is room for it. Raises ClosedError."""
        await self._writable.wait()
        self._raise_if_closed()
        self._protocol.send_text(text.encode())
        self._flush()

    def close(self, code: int, reason: str) -> None:
        """End it, with the reason as far as it fits. What still comes is not taken."""
        if self._transport.is_closing():
            return
        with suppress(InvalidState, ProtocolError):  # it is being closed already
            self._protocol.send_close(code, reason.encode()[:REASON_BYTES].decode(errors="ignore"))
        self._flush()
        self._give_up_in(END_S)
        self._there.set()
        self._transport.resume_reading()  # the page's own close

    def abort(self) -> None:
        """End it at once, without a word."""
        self._transport.abort()

    # ---- asyncio's

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=SEND_BYTES)
        connection: socket.socket = transport.get_extra_info("socket")
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, SEND_BYTES)
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
        """Take the frames that were parsed; False if no more may be parsed."""
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
                self._transport.pause_reading()  # until this has been taken
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
                self._transport.close()  # both sides have announced that it ends
                self._give_up_in(END_S)

    def _flooded(self) -> None:
        """Say why, and take nothing more: all that it sends costs time."""
        self._texts.clear()
        self._protocol.fail(POLICY_VIOLATION, TOO_MUCH)
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(self._layer.encrypt(data))
        self._transport.pause_reading()
        self._give_up_in(END_S)
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
