"""`hexapod-gateway console`: takes its address, prints the link, and serves until it is ended."""

import asyncio
import errno
import getpass
import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Final, NoReturn

import segno

from gateway import certs
from gateway.errors import AddressTakenError, ConfigError
from gateway.geometry import Geometry, load
from gateway.people.console import register
from gateway.people.console.app import MAX_CLOSING, MAX_PAGES, Console
from gateway.people.console.door import Door
from gateway.people.console.front import MAX_SIGNED_IN, MAX_UNKNOWN, Front, report
from gateway.people.console.link import STACK_BYTES, GatewayLink
from gateway.people.console.messages import ROLES, Role, least
from gateway.people.console.pages import Pages
from gateway.people.console.register import LINK_S, Register
from gateway.people.console.site import DEFAULT_PORT, LOCALHOST, Site
from gateway.people.console.stops import Stops, send_stopping
from gateway.people.console.tls import server_context
from gateway.people.terminal import hint, say, this_command
from gateway.robot.host import descriptors, logs, realtime
from gateway.robot.settings import LogSettings
from gateway.zenoh_config import client_config, get

BACKLOG: Final = 64
"""Connections that the kernel keeps until they are taken; it drops more."""
DEAD_MS: Final = 15_000
"""A connection that takes nothing for so long is given up: a page that is frozen, or whose machine is gone."""
RECEIVE_BYTES: Final = 8192
"""Of the kernel's buffer for each connection."""
OWN_DESCRIPTORS: Final = 96
"""For the Zenoh session, four more of them for STOP ALL and four for other Stops, the spare ones, and files."""
DESCRIPTORS: Final = MAX_UNKNOWN + MAX_SIGNED_IN + MAX_PAGES + MAX_CLOSING + OWN_DESCRIPTORS
"""There are fewer places for connections than descriptors, whoever comes."""


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
    card: str = ""
    """Of the page, which the first links lead to; empty: its beginning."""


def serve(options: Options) -> NoReturn:
    """Serve until SIGTERM or Ctrl-C, and end the process with 0. Raises ConfigError, AddressTakenError, ZenohError."""
    person, role, common_name = _identity(options.connect, options.zenoh_config)
    geometry = load(options.geometry)
    descriptors.ensure(DESCRIPTORS, "the console")
    realtime.limit_malloc_arenas()
    threading.stack_size(STACK_BYTES)
    with _listening(options.site) as listening:
        logs.set_up(LogSettings())  # from now on nobody waits for whoever reads what is written here
        found = Register(register.folder(), options.site.port)
        role = least(role, options.role)
        found.begin(options.site.url, role, common_name)
        asyncio.run(_run(options, listening, found, person, role, common_name, geometry))


def show(link: str) -> None:
    """Print a link; for a browser on another machine with its QR code."""
    say(f"The console is at {link}")
    say(f"The link works once, within {LINK_S // 60} minutes, and until the console is started again.")
    if link.startswith("https:") and os.isatty(1):
        segno.make(link, error="l").terminal(compact=True)


async def _run(
    options: Options,
    listening: list[socket.socket],
    found: Register,
    person: str,
    role: Role,
    common_name: str,
    geometry: Geometry,
) -> NoReturn:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    loop.set_exception_handler(report)
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    site, pages = options.site, Pages(common_name, found.revoke)
    gateway = GatewayLink(options.connect, options.zenoh_config, person, options.timeout_s, pages)
    stops = Stops(gateway.estop, send_stopping)
    console = Console(found, gateway, stops, pages, person=person, geometry=geometry)
    door = Door(site, found, person=person, role=role)
    context = server_context(site.certificate, site.key) if site.certificate and site.key else None
    Front(listening, context, door, console.admit).start()
    watching = asyncio.create_task(gateway.run())
    watching.add_done_callback(lambda _: ended.set())
    realtime.freeze_gc()
    if not options.listen_given and site.port != DEFAULT_PORT:
        hint(f"Port {DEFAULT_PORT} is taken by another program, so the console listens on {site.port}.")
    _say_where(site, found, options.card)
    with _opened(found, options.card) if options.open_browser else nullcontext():
        await ended.wait()
        await console.close()
    failed = watching.exception() if watching.done() else None
    watching.cancel()
    await gateway.close()
    if stops.unconfirmed:
        hint("STOP ALL was NOT confirmed: switch the servos' power off.")
    if failed is not None:
        raise failed
    # Not by the interpreter's own end: it would wait for threads that ask a gateway which does not answer.
    logs.close()
    os._exit(0)


def _say_where(site: Site, found: Register, card: str) -> None:
    """A link goes to a terminal only: whatever else reads this, such as a journal, is read by others, and kept."""
    where = "" if site.port == DEFAULT_PORT else f" --listen {site.address}:{site.port}"
    say(f"For a{'nother' if os.isatty(1) else ''} browser: {this_command()} console --link{where}")
    if os.isatty(1):
        show(found.new_link(card))
    else:
        say(f"The console is at {site.url}")


@contextmanager
def _opened(found: Register, card: str) -> Iterator[None]:
    """Open this machine's browser by a private file that goes on to a link: everybody sees a program's arguments."""
    file = found.path.with_suffix(".html")
    link = escape(found.new_link(card))
    content = f'<!doctype html><title>Console</title><meta http-equiv="refresh" content="0; url={link}">'
    register.write_private(file, content)
    asyncio.get_running_loop().call_later(LINK_S, partial(file.unlink, missing_ok=True))
    threading.Thread(target=partial(_open, file), name="browser", daemon=True).start()
    try:
        yield
    finally:
        file.unlink(missing_ok=True)


@contextmanager
def _listening(site: Site) -> Iterator[list[socket.socket]]:
    """At the site's address; at `localhost` at all of its addresses, so that nobody else listens at one of them."""
    with ExitStack() as stack:
        found = [_bound(stack, site, each) for each in (LOCALHOST if site.address == "localhost" else (site.address,))]
        taken = [each for each in found if each is not None]
        if not taken:
            raise ConfigError(f"--listen {site.address}:{site.port}: this machine has no such address")
        yield taken


def _bound(stack: ExitStack, site: Site, address: str) -> socket.socket | None:
    """None where this machine has no such address of localhost's, such as without IPv6."""
    try:
        family, kind, _, _, place = socket.getaddrinfo(
            address, site.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise ConfigError(f"--listen: {address} is no address of this machine: {error.strerror}") from error
    try:
        listening = stack.enter_context(socket.socket(family, kind))
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        listening.bind(place)
        listening.listen(BACKLOG)
    except OSError as error:
        where = f"{address}:{site.port}" if ":" not in address else f"[{address}]:{site.port}"
        if error.errno == errno.EADDRINUSE:
            raise AddressTakenError(
                f"{where} is taken by another program (perhaps another console); stop it, or set another --listen"
            ) from error
        if site.address == "localhost" and error.errno in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
            return None
        raise ConfigError(f"--listen {where}: {error.strerror}; name an address of this machine") from error
    return listening


def _identity(connect: str | None, zenoh_config: Path | None) -> tuple[str, Role, str]:
    """Whose console it is, what it may do at most, and its common name: by its certificate; without one, the user's."""
    config = client_config(connect, zenoh_config)
    certificate = get(config, "transport/link/tls/connect_certificate")
    if certificate:
        holder = certs.folder.describe(Path(certificate))
        role: Role = next((each for each in ROLES if each == holder.role.partition(".")[0]), "observer")
        return holder.name, role, holder.common_name
    with suppress(OSError, KeyError):
        return getpass.getuser(), "operator", ""
    return "console", "operator", ""


def _open(file: Path) -> None:
    if not webbrowser.open(file.as_uri()):
        hint(f"no browser could be opened here; for a link: {this_command()} console --link")
