"""Serves the metrics over HTTP, on one thread, and to so many a second.

A thread for each connection is what delays Stops on a busy machine: to start one takes the interpreter's lock, and so
does each of its system calls; whoever connects again and again has a thousand of them started in a second. Here one
thread has a loop of its own. It accepts MOST_A_SECOND connections, and what it does for each is bounded.
"""

import asyncio
import logging
import socket
from contextlib import suppress
from io import BytesIO
from socketserver import TCPServer
from threading import Thread
from typing import TYPE_CHECKING, Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from gateway.errors import ConfigError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread

if TYPE_CHECKING:
    from _typeshed.wsgi import WSGIApplication

MOST_REQUESTS: Final = 8
"""At once: one Prometheus needs one, and a person who looks another."""
MOST_A_SECOND: Final = 25
"""Connections. Each may ask for a page, which takes 5 ms: an eighth of a processor at most, and of lower priority."""
WAITING: Final = 32
"""Connections that the kernel keeps meanwhile: a scrape waits for them for 1.3 s at most, of Prometheus's ten."""
REQUEST_S: Final = 5.0
"""A scrape takes 5 ms; Prometheus itself gives up after ten seconds."""
MAX_REQUEST_BYTES: Final = 8192
"""Prometheus sends some 300, a browser 1000."""
NO_DESCRIPTOR_S: Final = 0.5
"""How long nothing is accepted where that has failed, since the process has no file descriptor left."""

logger = logging.getLogger(__name__)


class MetricsPage(WSGIServer):
    """A listening socket and the page behind it. Raises ConfigError where the address cannot be had."""

    request_queue_size = WAITING

    def __init__(self, address: str, page: "WSGIApplication") -> None:
        """May wait for a name server, so not for the loop's thread."""
        host, _, port = address.rpartition(":")
        try:
            family, *_, where = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
            self.address_family = family
            super().__init__((str(where[0]), int(where[1])), _Request)
        except OSError as error:
            raise ConfigError(f"telemetry.metrics: {address} cannot be opened: {error.strerror or error}") from error
        self.set_app(page)
        self.socket.setblocking(False)
        self._answering: dict[asyncio.Task[None], socket.socket] = {}

    def server_bind(self) -> None:
        # Not as HTTPServer does, which asks the network for this machine's full name, and nobody here wants that.
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()

    def start(self) -> None:
        """Serve from a thread of its own, until the process ends."""
        Thread(target=self._run, name="metrics", daemon=True).start()

    def _run(self) -> None:
        prefer_thread(PAGE_PRIORITY)
        asyncio.run(self._accept())

    async def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, _ = await loop.sock_accept(self.socket)
            except OSError as error:
                logger.debug("no connection for metrics could be accepted: %s", error)
                await asyncio.sleep(NO_DESCRIPTOR_S)
                continue
            if len(self._answering) >= MOST_REQUESTS:
                next(iter(self._answering)).cancel()  # the oldest
            task = loop.create_task(self._answer(connection))
            self._answering[task] = connection
            task.add_done_callback(self._hang_up)
            await asyncio.sleep(1 / MOST_A_SECOND)

    def _hang_up(self, task: "asyncio.Task[None]") -> None:
        self._answering.pop(task).close()
        if not task.cancelled() and task.exception() is not None:
            logger.debug("a request for metrics failed", exc_info=task.exception())

    async def _answer(self, connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        connection.setblocking(False)
        with suppress(TimeoutError, OSError):
            async with asyncio.timeout(REQUEST_S):
                request = b""
                while b"\r\n\r\n" not in request:
                    more = await loop.sock_recv(connection, MAX_REQUEST_BYTES)
                    request += more
                    if not more or len(request) > MAX_REQUEST_BYTES:
                        return
                await loop.sock_sendall(connection, self._response_to(request, connection.getsockname()[0]))

    def _response_to(self, request: Any, reached: str) -> bytes:
        """`request` is bytes; a handler of wsgiref's would take a socket, and `_Request` does not.

        `reached`: the address of ours to which it came; the one that listens may be all of them.
        """
        self.base_environ["SERVER_NAME"] = reached.removeprefix("::ffff:")
        return _Request(request, ("", 0), self).response


class _Request(WSGIRequestHandler):
    """Reads a request that has come whole, and has `response` then."""

    request: Any

    def setup(self) -> None:
        self._written = BytesIO()
        self.rfile, self.wfile = BytesIO(self.request), self._written

    def finish(self) -> None:
        self.response = self._written.getvalue()

    def log_message(self, *_: object) -> None:
        """Log nothing."""
