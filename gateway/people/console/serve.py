"""`hexapod-gateway console`: takes its address, prints the link, and serves until it is ended."""

import asyncio
import getpass
import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Final, NoReturn

import segno

from gateway import certs
from gateway.geometry import Geometry, load
from gateway.host import descriptors, logs, realtime
from gateway.people.console import sessions
from gateway.people.console.app import MAX_CLOSING, MAX_PAGES, Console
from gateway.people.console.auth import Door
from gateway.people.console.link import STACK_BYTES, GatewayLink
from gateway.people.console.listener import MAX_SIGNED_IN, MAX_UNKNOWN, Front, report
from gateway.people.console.messages import ROLES, Role, least
from gateway.people.console.pages import Pages
from gateway.people.console.sessions import LINK_S, Register
from gateway.people.console.site import DEFAULT_PORT, Site
from gateway.people.console.sockets import listening
from gateway.people.console.stops import Stops, send_stopping
from gateway.people.console.tls import server_context
from gateway.people.terminal import hint, say, this_command
from gateway.robot.settings import LogSettings
from gateway.zenoh_config import client_config, get

OWN_DESCRIPTORS: Final = 96
"""For the Zenoh session, four more of them for STOP ALL and four for other Stops, the spare ones, and files."""
DESCRIPTORS: Final = MAX_UNKNOWN + MAX_SIGNED_IN + MAX_PAGES + MAX_CLOSING + OWN_DESCRIPTORS
"""There are fewer places for connections than descriptors, whoever comes."""


@dataclass(frozen=True)
class Options:
    """The command's."""

    site: Site
    passed: Sequence[socket.socket]
    """Sockets of systemd's, on which it listens; empty: it binds by itself."""
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
    with listening(options.site, options.passed) as sockets:
        logs.set_up(LogSettings())  # from now on nobody waits for whoever reads what is written here
        found = Register(register.folder(), options.site.port)
        role = least(role, options.role)
        found.begin(options.site.url, role, common_name)
        asyncio.run(_run(options, sockets, found, person, role, common_name, geometry))


def show(link: str) -> None:
    """Print a link; for a browser on another machine with its QR code."""
    say(f"The console is at {link}")
    say(f"The link works once, within {LINK_S // 60} minutes, and until the console is started again.")
    if link.startswith("https:") and os.isatty(1):
        segno.make(link, error="l").terminal(compact=True)


async def _run(
    options: Options,
    sockets: Sequence[socket.socket],
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
    Front(sockets, context, door, console.admit).start()
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
