"""`hexapod-gateway console`: takes its address, says the link, and serves until it is ended."""

import asyncio
import errno
import getpass
import os
import signal
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NoReturn

import segno
import uvicorn
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from gateway import certs
from gateway.client import DEFAULT_ENDPOINT
from gateway.console import register
from gateway.console.app import Console
from gateway.console.link import GatewayLink
from gateway.console.messages import MAX_BYTES, Role
from gateway.console.pages import Pages
from gateway.console.register import LINK_ELSEWHERE_S, LINK_S, Register
from gateway.console.site import DEFAULT_PORT, Site
from gateway.console.stops import Stops
from gateway.edge.config_file import get
from gateway.edge.session import client_config
from gateway.errors import AddressTakenError, ConfigError
from gateway.geometry import load
from gateway.tools.terminal import hint, say, this_command

BACKLOG: Final = 64
MAX_CONNECTIONS: Final = 256
"""Pages, and the files that they load; more of them get 503."""
DEAD_MS: Final = 15_000
"""A connection that takes nothing for so long is given up: a page that is frozen, or whose machine is gone."""
END_S: Final = 1
RECEIVE_BYTES: Final = MAX_BYTES
"""Of the kernel's buffer: what has come from one page is taken at once, and meanwhile a STOP ALL of another waits."""
SEND_BYTES: Final = 4096
"""Of what waits for one page in this process, and in the kernel besides what is under way: some five states."""
MAX_BYTES_A_SECOND: Final = 131_072.0
"""From one page; one that drives each leg by a message of its own sends 40 000."""


@dataclass(frozen=True)
class Options:
    """The command's."""

    site: Site
    listen_given: bool
    connect: str | None
    zenoh_config: Path | None
    timeout_s: float
    role: Role
    geometry: Path | None
    open_browser: bool


def serve(options: Options) -> NoReturn:
    """Serve until SIGTERM or Ctrl-C, and end the process with 0. Raises ConfigError, AddressTakenError, ZenohError."""
    connect = options.connect
    if connect is None and options.zenoh_config is None:
        connect = DEFAULT_ENDPOINT
    person, role = _identity(connect, options.zenoh_config)
    geometry = load(options.geometry).model_dump(mode="json")
    with _listening(options.site) as listening:
        found = Register(register.folder(), options.site.port)
        role = _least(role, options.role)
        found.begin(options.site.url, LINK_S if options.site.certificate is None else LINK_ELSEWHERE_S, role)
        asyncio.run(_run(options, listening, found, found.new_link(), connect, person, role, geometry))


def show(link: str) -> None:
    """Print a link; for a browser on another machine with its QR code."""
    say(f"The console is at {link}")
    if link.startswith("https:"):
        say(f"The link works once, within {LINK_ELSEWHERE_S // 60} minutes.")
        if os.isatty(1):
            segno.make(link, error="l").terminal(compact=True)


async def _run(
    options: Options,
    listening: socket.socket,
    found: Register,
    link: str,
    connect: str | None,
    person: str,
    role: Role,
    geometry: Any,
) -> NoReturn:
    pages = Pages()
    gateway = GatewayLink(connect, options.zenoh_config, person, options.timeout_s, pages)
    stops = Stops(gateway.estop)
    console = Console(options.site, found, gateway, stops, pages, person=person, role=role, geometry=geometry)
    server = _Server(
        uvicorn.Config(
            console.app(),
            ws=_WebSocket,
            http="h11",
            lifespan="off",
            log_config=None,
            log_level="error",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            ws_max_size=MAX_BYTES,
            ws_per_message_deflate=False,  # a page in a LAN needs no compression, a Pi needs its processor
            limit_concurrency=MAX_CONNECTIONS,
            timeout_graceful_shutdown=END_S,
            ssl_certfile=options.site.certificate,
            ssl_keyfile=options.site.key,
        )
    )
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, server.end)
    watching = asyncio.create_task(gateway.run())
    watching.add_done_callback(lambda _: server.end())
    where = "" if options.site.port == DEFAULT_PORT else f" --listen {options.site.address}:{options.site.port}"
    say(f"For another browser: {this_command()} console --link{where}")
    if not options.listen_given and options.site.port != DEFAULT_PORT:
        hint(f"Port {DEFAULT_PORT} is taken by another program, so the console listens on {options.site.port}.")
    show(link)
    if options.open_browser:
        threading.Thread(target=partial(_open, link), daemon=True).start()
    await server.serve(sockets=[listening])
    failed = None if watching.cancelled() or not watching.done() else watching.exception()
    watching.cancel()
    await gateway.close()
    if stops.unconfirmed:
        hint("STOP ALL was NOT confirmed: switch the servos' power off.")
    if failed is not None:
        raise failed
    # Not by the interpreter's own end: it would wait for threads that ask a gateway which does not answer.
    sys.stdout.flush()
    os._exit(0)


class _WebSocket(WebSocketsSansIOProtocol):
    """Gives up on a page that floods, also after it was told to go: it may not listen, and all it sends costs time.

    And keeps little for one that reads slowly: what waits in buffers is the past, and the newest state waits behind it.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._allowed = MAX_BYTES_A_SECOND
        self._counted_s = time.monotonic()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.transport.set_write_buffer_limits(high=SEND_BYTES)
        connection: socket.socket = self.transport.get_extra_info("socket")
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, SEND_BYTES)

    def data_received(self, data: bytes) -> None:
        now_s = time.monotonic()
        refilled = self._allowed + (now_s - self._counted_s) * MAX_BYTES_A_SECOND
        self._allowed = min(MAX_BYTES_A_SECOND, refilled) - len(data)
        self._counted_s = now_s
        if self._allowed < 0:
            self.transport.abort()
        else:
            super().data_received(data)


class _Server(uvicorn.Server):
    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Not uvicorn's: it raises the signal again, and the exit code would be the signal's."""
        yield

    def end(self) -> None:
        """Stop serving."""
        self.force_exit = self.should_exit
        self.should_exit = True


@contextmanager
def _listening(site: Site) -> Iterator[socket.socket]:
    try:
        family, kind, _, _, address = socket.getaddrinfo(
            site.address, site.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise ConfigError(f"--listen: {site.address} is no address of this machine: {error.strerror}") from error
    with socket.socket(family, kind) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        try:
            listening.bind(address)
            listening.listen(BACKLOG)
        except OSError as error:
            where = f"{site.address}:{site.port}"
            if error.errno == errno.EADDRINUSE:
                raise AddressTakenError(
                    f"{where} is taken by another program (perhaps another console); stop it, or set another --listen"
                ) from error
            raise ConfigError(f"--listen {where}: {error.strerror}; name an address of this machine") from error
        yield listening


def _identity(connect: str | None, zenoh_config: Path | None) -> tuple[str, Role]:
    """Whose console it is and what it may do at most: by its certificate; without one, the user's name."""
    config = client_config(connect, zenoh_config)
    certificate = get(config, "transport/link/tls/connect_certificate")
    if certificate:
        holder = certs.describe(Path(certificate))
        return holder.name, "operator" if holder.role.partition(".")[0] == "operator" else "observer"
    with suppress(OSError, KeyError):
        return getpass.getuser(), "operator"
    return "console", "operator"


def _least(first: Role, second: Role) -> Role:
    return "operator" if first == second == "operator" else "observer"


def _open(link: str) -> None:
    if not webbrowser.open(link):
        hint("no browser could be opened here; open the address above")
