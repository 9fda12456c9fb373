"""A page that is signed in and floods the console, is thrown out, and comes again.

    python -m tests.attack.flooding_page KIND URL COOKIE KEY

KIND is a name in `FRAMES`. It prints `flooding` when it has begun, and `ended` each time that it was thrown out.
"""

import asyncio
import ssl
import sys
from contextlib import suppress
from typing import Final

from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException
from websockets.frames import Frame, Opcode
from websockets.typing import Origin

from tests.support.console_process import SignedIn

FRAMES: Final = {
    "pings": Frame(Opcode.PING, b""),
    "pongs": Frame(Opcode.PONG, b"x"),
    "fragments": Frame(Opcode.CONT, b"", fin=False),
    "messages": Frame(Opcode.TEXT, b'{"type":"alive","now_ms":1}'),
}
AT_ONCE: Final = 200
AGAIN_S: Final = 0.05


async def flood(kind: str, url: str, session: SignedIn) -> None:
    """Never ends."""
    context = None
    if url.startswith("https"):
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    first = Frame(Opcode.TEXT, b"x", fin=False).serialize(mask=True) if kind == "fragments" else b""
    many = FRAMES[kind].serialize(mask=True) * AT_ONCE
    print("flooding", flush=True)
    while True:
        with suppress(OSError, EOFError, WebSocketException, TimeoutError):
            async with connect(
                url.replace("http", "ws", 1) + "/ws",
                additional_headers={"Cookie": session.cookie},
                origin=Origin(url),
                subprotocols=session.subprotocols(url, context),
                ssl=context,
                compression=None,
                close_timeout=0.1,
            ) as socket:
                socket.transport.write(first)
                while not socket.transport.is_closing() and socket.close_code is None:
                    socket.transport.write(many)
                    await asyncio.sleep(AT_ONCE / 21_000)  # the rate at which pings stay below the limit of bytes
        print("ended", flush=True)
        await asyncio.sleep(AGAIN_S)


if __name__ == "__main__":
    asyncio.run(flood(sys.argv[1], sys.argv[2], SignedIn(*sys.argv[3:])))
