"""Serves the metrics over HTTP, on one thread with its own loop, with at most MOST_A_SECOND connections a second.

A thread for each connection would delay Stops: its start and each of its system calls take the interpreter's lock, and
one client that keeps reconnecting started a thousand threads in a second.
"""

import asyncio
import logging
import socket
from collections.abc import Callable, Collection
from functools import partial
from http.client import parse_headers
from io import BytesIO
from threading import Thread
from typing import Final

from prometheus_client import CONTENT_TYPE_LATEST

from gateway.errors import ConfigError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread

METRICS_PATH: Final = "/metrics"
LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})
MOST_REQUESTS: Final = 8
"""Open at once. A Prometheus server needs one, a browser another."""
MOST_A_SECOND: Final = 25
"""Connections. A page takes 5 ms, so they take an eighth of a processor at most, at a low priority."""
WAITING: Final = 32
"""Connections that the kernel queues. They delay a scrape by 1.3 s at most; Prometheus waits ten seconds."""
REQUEST_S: Final = 5.0
"""A scrape takes 5 ms; Prometheus itself gives up after ten seconds."""
MAX_REQUEST_BYTES: Final = 8192
"""Prometheus sends about 300 bytes, a browser 1000."""
NO_DESCRIPTOR_S: Final = 0.5
"""Pause after an accept that failed because the process has no file descriptor left."""

logger = logging.getLogger(__name__)


def serve(address: str, page: Callable[[], bytes], ours: Collection[str]) -> None:
    """Serve `page` at METRICS_PATH of `address` (`host:port`) from a thread of its own, until the process ends.

    Requests from other sites' pages get 403, and so do requests for a host that is neither the loopback, one of `ours`,
    nor the address that they reached. Raises ConfigError if the address cannot be opened. May wait for a name server,
    so do not call it on the loop's thread.
    """
    host, _, port = address.rpartition(":")
    try:
        family, kind, _, _, where = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(where)
        listening.listen(WAITING)
    except OSError as error:
        raise ConfigError(f"telemetry.metrics: {address} cannot be opened: {error.strerror or error}") from error
    listening.setblocking(False)

    def run() -> None:
        prefer_thread(PAGE_PRIORITY)
        asyncio.run(_accept(listening, partial(_response_to, page, ours)))

    Thread(target=run, name="metrics", daemon=True).start()


async def _accept(listening: socket.socket, response_to: Callable[[bytes, str], bytes]) -> None:
    loop, answering = asyncio.get_running_loop(), dict[asyncio.Task[None], None]()
    while True:
        try:
            connection, _ = await loop.sock_accept(listening)
        except OSError as error:
            logger.debug("no connection for metrics could be accepted: %s", error)
            await asyncio.sleep(NO_DESCRIPTOR_S)
            continue
        if len(answering) >= MOST_REQUESTS:
            next(iter(answering)).cancel()  # the oldest
        task = loop.create_task(_answer(connection, response_to))
        answering[task] = None
        task.add_done_callback(answering.pop)
        await asyncio.sleep(1 / MOST_A_SECOND)


async def _answer(connection: socket.socket, response_to: Callable[[bytes, str], bytes]) -> None:
    loop = asyncio.get_running_loop()
    try:
        with connection:
            connection.setblocking(False)
            async with asyncio.timeout(REQUEST_S):
                request = b""
                while b"\r\n\r\n" not in request:
                    more = await loop.sock_recv(connection, MAX_REQUEST_BYTES)
                    request += more
                    if not more or len(request) > MAX_REQUEST_BYTES:
                        return
                await loop.sock_sendall(connection, response_to(request, connection.getsockname()[0]))
    except Exception as error:
        logger.debug("a request for metrics failed", exc_info=error)


def _response_to(page: Callable[[], bytes], ours: Collection[str], request: bytes, reached: str) -> bytes:
    """`reached` is the address of ours that the client dialled; the socket may listen on all addresses."""
    first, _, rest = request.partition(b"\r\n")
    path, headers = first.decode("latin-1").split(" ")[1].partition("?")[0], parse_headers(BytesIO(rest))
    kind = "text/plain"
    if not may_ask(headers["Host"], headers["Origin"], {*LOOPBACK, *ours, reached.removeprefix("::ffff:")}):
        status, body = "403 Forbidden", b"not under this name: ask by this machine's name or address\n"
    elif path != METRICS_PATH:
        status, body = "404 Not Found", f"the numbers are at {METRICS_PATH}\n".encode()
    else:
        status, kind, body = "200 OK", CONTENT_TYPE_LATEST, page()
    return f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\n\r\n".encode() + body


def may_ask(host: str | None, origin: str | None, ours: Collection[str]) -> bool:
    """Return whether a request comes from our own page, or from no page (`origin` is None).

    A page of another site can reach every port of its browser's machine. Its `origin` shows that; or, if one of its own
    names resolves to this machine (DNS rebinding), `host` does: a page cannot choose the Host header that its browser
    sends (`robot.local:9464`, `[::1]:9464`). The port is not compared, since a tunnel changes it.
    """
    name = (host or "").lower()
    if name.startswith("["):
        name = name[1:].partition("]")[0]
    elif name.count(":") == 1:
        name = name.partition(":")[0]
    return name in ours and (origin is None or origin == f"http://{host}")
