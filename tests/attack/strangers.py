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
from typing import Final, NamedTuple

from tests.support.child import Child


class Kind(NamedTuple):
    """What a stranger sends on a connection, on which it then waits until the other side closes."""

    head: bytes = b""
    shakes_hands: bool = False
    """It makes a TLS connection, where the console has TLS."""
    goes_on: bool = False
    """Behind the head it sends a byte at a time; an answer alone does not end that."""
    leaves: bool = False
    """It does not wait."""


KINDS: Final = {
    "silent": Kind(),
    "half_open": Kind(bytes.fromhex("16030102000100") + bytes(200)),  # the rest of this handshake does not come
    "handshake": Kind(shakes_hands=True, leaves=True),
    "slow_headers": Kind(b"GET / HTTP/1.1\r\nHost: %b\r\nX-Slow: ", shakes_hands=True, goes_on=True),
    "get": Kind(b"GET / HTTP/1.1\r\nHost: %b\r\nCookie: hexapod-console-8080=nonsense\r\n\r\n", shakes_hands=True),
    "garbage": Kind(os.urandom(3000).replace(b"%", b"")),
}


async def connect(kind: Kind, host: str, port: int, context: ssl.SSLContext | None, made: list[int]) -> None:
    """One connection of this kind; `made` gets one more."""
    reader, writer = await asyncio.open_connection(host, port, ssl=context if kind.shakes_hands else None)
    made[0] += 1
    answer = asyncio.create_task(reader.read())
    with suppress(OSError):
        writer.write(kind.head.replace(b"%b", f"{host}:{port}".encode()))
        while kind.goes_on and not answer.done():
            writer.write(b"x")
            await writer.drain()
            await asyncio.sleep(0.005)
        if not kind.leaves:
            await answer
    writer.transport.abort()
    answer.cancel()


async def attack(kind: str, host: str, port: int, count: int, *, tls: bool) -> None:
    """Never ends."""
    made, context = [0], ssl.create_default_context() if tls else None
    if context is not None:
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE

    async def again_and_again() -> None:
        while True:
            with suppress(OSError, EOFError):
                await connect(KINDS[kind], host, port, context, made)
            await asyncio.sleep(0)

    tasks = [asyncio.create_task(again_and_again()) for _ in range(count)]
    while True:
        await asyncio.wait(tasks, timeout=0.3)
        print("made", *made, flush=True)


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
