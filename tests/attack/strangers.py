"""Connections without a session or certificate to a console's listener, again and again until killed.

    python -m tests.attack.strangers KIND HOST PORT COUNT [plain]

KIND is a name in `KINDS`, COUNT how many connections at once. It prints again and again how many have been made so far.
Strangers have a machine of their own, so they leave this one's processors to whoever else wants them.
"""

import asyncio
import os
import resource
import ssl
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from tests.support.child import Child

CLIENT_HELLO_HALF: Final = bytes.fromhex("16030102000100") + bytes(200)
"""The beginning of a handshake whose rest does not come."""


class Stranger:
    """Makes connections to one address."""

    def __init__(self, host: str, port: int, *, tls: bool) -> None:
        self.host = f"{host}:{port}"
        self.made = 0
        self._address = (host, port)
        self._context: ssl.SSLContext | None = None
        if tls:
            self._context = ssl.create_default_context()
            self._context.check_hostname = False
            self._context.verify_mode = ssl.CERT_NONE

    async def open(self, *, tcp_only: bool = False) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """A connection, with TLS unless it is only to be opened."""
        opened = await asyncio.open_connection(*self._address, ssl=None if tcp_only else self._context)
        self.made += 1
        return opened

    # ---- each once; they are repeated

    async def silent(self) -> None:
        """Says nothing."""
        reader, writer = await self.open(tcp_only=True)
        with suppress(OSError):
            await reader.read()
        writer.transport.abort()

    async def half_open(self) -> None:
        """Half of a handshake."""
        reader, writer = await self.open(tcp_only=True)
        writer.write(CLIENT_HELLO_HALF)
        with suppress(OSError):
            await reader.read()
        writer.transport.abort()

    async def handshake(self) -> None:
        """A handshake, and good-bye."""
        _, writer = await self.open()
        writer.transport.abort()

    async def slow_headers(self) -> None:
        """A byte at a time."""
        await self._send_on(f"GET / HTTP/1.1\r\nHost: {self.host}\r\nX-Slow: ", b"x", pause_s=0.005)

    async def get(self) -> None:
        """A request like that of a page, and its answer."""
        await self._ask("GET / HTTP/1.1\r\nHost: {host}\r\nCookie: hexapod-console-8080=nonsense\r\n\r\n")

    async def garbage(self) -> None:
        """Random bytes instead of a handshake or a request."""
        reader, writer = await self.open(tcp_only=True)
        with suppress(OSError):
            writer.write(os.urandom(3000))
            await reader.read()
        writer.transport.abort()

    async def _send_on(self, head: str, more: bytes, pause_s: float = 0.0) -> None:
        """Until the other side closes; its answer alone does not end it."""
        reader, writer = await self.open()
        answer = asyncio.create_task(reader.read())
        with suppress(OSError):
            writer.write(head.encode())
            while not answer.done():
                writer.write(more)
                await writer.drain()
                await asyncio.sleep(pause_s)
        writer.transport.abort()
        answer.cancel()

    async def _ask(self, request: str) -> None:
        reader, writer = await self.open()
        with suppress(OSError):
            writer.write(request.format(host=self.host).encode())
            await reader.read()
        writer.transport.abort()


KINDS: Final = {
    "silent": Stranger.silent,
    "half_open": Stranger.half_open,
    "handshake": Stranger.handshake,
    "slow_headers": Stranger.slow_headers,
    "get": Stranger.get,
    "garbage": Stranger.garbage,
}


async def attack(kind: str, host: str, port: int, count: int, *, tls: bool) -> None:
    """Never ends."""
    stranger = Stranger(host, port, tls=tls)

    async def again_and_again() -> None:
        while True:
            with suppress(OSError, EOFError):
                await KINDS[kind](stranger)
            await asyncio.sleep(0)

    tasks = [asyncio.create_task(again_and_again()) for _ in range(count)]
    while True:
        await asyncio.wait(tasks, timeout=0.3)
        print("made", stranger.made, flush=True)


@contextmanager
def strangers(kind: str, port: int, count: int, *plain: str) -> Iterator[None]:
    """Connections without a session to a console of this machine, so many at once."""
    program = [sys.executable, "-m", "tests.attack.strangers", kind, "127.0.0.1", str(port), str(count), *plain]
    with Child(program, os.environ) as child:
        child.wait_for_output("made ", 20)
        yield


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_NOFILE, (4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    name, address, number, at_once, *more = sys.argv[1:]
    os.nice(15)
    asyncio.run(attack(name, address, int(number), int(at_once), tls=not more))
