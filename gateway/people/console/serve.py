"""`hexapod-gateway console`: takes its address, prints the link, and serves pages until it is ended."""

import asyncio
import getpass
import logging
import os
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from html import escape
from pathlib import Path
from typing import Final, NamedTuple, NoReturn
from urllib.parse import urlsplit

import segno
from aiohttp import WSCloseCode, web

from gateway import __version__, certs
from gateway.errors import WalkError
from gateway.files import durable
from gateway.geometry import Geometry, load
from gateway.host import descriptors, logs, realtime
from gateway.host.directories import console_state
from gateway.people.commands.options import Reach
from gateway.people.console import ConsoleOptions, phone
from gateway.people.console.link import STACK_BYTES, GatewayLink, Shared
from gateway.people.console.pages.page_messages import ROLES, Role, json_of, least
from gateway.people.console.pages.page_tasks import EndError, Stops, send_stopping
from gateway.people.console.pages.pages import Page, Pages
from gateway.people.console.server.auth import CAMERA, HEADERS, Auth
from gateway.people.console.server.listener import MAX_CONNECTIONS, HttpListener, WebSocket
from gateway.people.console.server.sessions import LINK_S, Entry, Sessions
from gateway.people.console.server.site import LOCALHOST, Site, listening
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.planning import lying_deg
from gateway.people.walking.robot import Robot
from gateway.people.watching.camera import MAX_CAMERAS, Camera, cameras
from gateway.rate_limit import NS_PER_MS
from gateway.zenoh.config import client_config, get

MAX_PAGES: Final = 64
"""Open at once, as many as the gateway takes sessions."""
MAX_CLOSING: Final = 16
"""Further WebSockets, which are being closed; those beyond are rejected."""
SIT_S: Final = 3.5
"""The longest wait for a robot that sits down, which takes 2 s. systemd kills the console 5 s after its signal."""
CHECK_S: Final = 1.0
"""The period in which each page's session is checked, and the longest wait for a picture."""
SIGNED_OUT: Final = "signed out"


class Console:
    """Serves the pages, with what they share."""

    def __init__(
        self, sessions: Sessions, pages: Pages, shared: Shared, found: Mapping[str, Camera], commands: Mapping[str, str]
    ) -> None:
        """`found`: the cameras by name. `commands`: what starts it again, and prints a link, for a page's viewer."""
        self._sessions = sessions
        self._pages = pages
        self._shared = shared
        self._cameras = found
        self._open: set[WebSocket] = set()
        lying: dict[int, float] = {}
        with suppress(WalkError):  # a robot that cannot lie
            lying = lying_deg(Robot(shared.geometry))
        self._about = {
            "person": shared.person,
            "version": __version__,
            "geometry": shared.geometry,
            "lying": lying,
            "gaits": tuple(GAITS),
            "cameras": tuple(found),
            "stale_ms": shared.stale_ms,
            "commands": commands,
        }
        """The part of a page's first message that is the same for all."""

    async def serve(self, request: web.BaseRequest, session: Entry) -> web.StreamResponse:
        """Answer a page's WebSocket, and return once that has ended; or its request for a picture."""
        if request.path.startswith(CAMERA):
            return await self._serve_picture(request, session)
        if len(self._open) >= MAX_PAGES + MAX_CLOSING:
            return web.Response(status=503)
        websocket = WebSocket()
        self._open.add(websocket)
        try:
            await websocket.prepare(request)
            if len(self._pages) >= MAX_PAGES:
                await websocket.end(WSCloseCode.TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open; close one")
            else:
                await self._serve_page(websocket, session, request.query.get("tab", ""))
        finally:
            self._open.discard(websocket)
        return websocket

    async def _serve_picture(self, request: web.BaseRequest, session: Entry) -> web.StreamResponse:
        """Answer with a newer picture than the page has, or with the reason why there is none, within `CHECK_S`."""
        asked_ns, name = time.monotonic_ns(), request.path.removeprefix(CAMERA)
        page = next((each for each in self._pages if each.secret == request.query.get("page")), None)
        if page is None or name not in self._cameras or page.picture_request.locked():
            return web.Response(status=403 if page is None else 409)
        async with page.picture_request:
            page.camera.confirm(name, request.query.get("shown", ""))
            found = await self._cameras[name].newer(page.camera.sent, CHECK_S)
            if not self._sessions.still_valid(session):
                return web.Response(status=403)
            if found is None:
                return web.Response(status=202, text=self._cameras[name].trouble, headers=HEADERS)
            page.camera.sent = found
            about = {"X-Picture": str(found.taken_ns), "X-Taken-Ms": str((found.taken_ns - asked_ns) / NS_PER_MS)}
            response = web.Response(body=found.jpeg, headers=HEADERS | about, content_type="image/jpeg")
            with suppress(ConnectionError):
                await response.prepare(request)
                await response.write_eof()
        return response

    async def close(self) -> None:
        """Close all pages, and release their leases. No page is waited for longer than a second (`WebSocket.end`)."""
        pages = [*self._pages]
        why = WSCloseCode.SERVICE_RESTART, "the console ends"
        ends = [websocket.end(*why) for websocket in self._open if websocket.prepared]
        await asyncio.gather(*ends, return_exceptions=True)
        await asyncio.gather(*(page.release() for page in pages))

    async def _serve_page(self, websocket: WebSocket, session: Entry, tab: str) -> None:
        """`tab`: the browser's, by a name that it gave itself: the same after a reload. Empty: it gave none."""
        tab = f"{session.sha256} {tab[:32]}" if tab.isalnum() else ""
        page = Page(next(self._pages.numbers), session.role, self._shared, self._pages.former(tab))
        own = {"source": page.source, "names": page.names, "last_id": page.last_id, "page": page.secret}
        self._pages.add(page)
        why = ""
        try:
            await websocket.put(json_of({"type": "hello", "role": session.role, **own, **self._about}))
            page.go_on()
            async with asyncio.TaskGroup() as tasks:  # the first that fails ends the others
                for work in (self._receive(websocket, page), self._send(websocket, page), self._check(session)):
                    tasks.create_task(work)
        except* (ConnectionError, TimeoutError):  # TimeoutError: it does not read, so it gets no reason
            pass
        except* EndError as ends:
            why = str(ends.exceptions[0])
        finally:
            self._pages.remove(page, tab)
            page.close()
        if why:
            await websocket.end(WSCloseCode.POLICY_VIOLATION, why)

    async def _receive(self, websocket: WebSocket, page: Page) -> None:
        while True:
            page.take(await websocket.take())

    async def _send(self, websocket: WebSocket, page: Page) -> None:
        while True:
            for text in await page.outgoing.wait():
                await websocket.put(text)

    async def _check(self, session: Entry) -> None:
        while True:
            if not self._sessions.still_valid(session):
                raise EndError(SIGNED_OUT)
            await asyncio.sleep(CHECK_S)


OWN_DESCRIPTORS: Final = 96
"""Descriptors for the Zenoh session, four more sessions for STOP ALL, four for other Stops, a reserve, and files."""
DESCRIPTORS: Final = MAX_CONNECTIONS + MAX_PAGES + MAX_CLOSING + MAX_CAMERAS + OWN_DESCRIPTORS
"""More than the places for connections, so that no flood of connections takes all."""

_log: Final = logging.getLogger(__name__)


class Owner(NamedTuple):
    """The owner by the console's certificate; without one the user, with an empty common name."""

    person: str
    role: Role
    """The most rights that pages get."""
    common_name: str


def serve(options: ConsoleOptions, site: Site, passed: Sequence[socket.socket], card: str) -> NoReturn:
    """Serve until SIGTERM or Ctrl-C, and end the process with 0. Raises ConfigError, AddressTakenError, ZenohError.

    `passed`: systemd's sockets; empty: the console binds its own. `card`: of the page, to which the first link leads.
    """
    owner = _owner(options.reach)
    owner = owner._replace(role=least(owner.role, options.role))
    geometry = load(options.geometry)
    descriptors.ensure(DESCRIPTORS, "the console")
    realtime.limit_malloc_arenas()
    threading.stack_size(STACK_BYTES)
    door = phone.door(site) if options.phone else None
    streams = cameras(options.camera or ())
    with listening(site, passed) as sockets, listening(door) if door else nullcontext(()) as doors:
        logs.set_up()  # from now on another thread writes the log: no slow reader delays this process
        found = Sessions(console_state(), site.port)
        found.begin(f"{door.url}/#{site.port}," if door else f"{site.url}/?token=", owner.role, owner.common_name)
        asyncio.run(_run(options, site, (sockets, doors), found, owner, geometry, streams, card))


def show(link: str) -> None:
    """Print a link, for a browser on another machine also its QR code."""
    say(f"The console is at {link}")
    say(f"The link works once. It expires after {LINK_S // 60} minutes, or when the console restarts.")
    if urlsplit(link).hostname not in (*LOCALHOST, "localhost") and os.isatty(1):
        segno.make(link, error="l").terminal(compact=True)
    if "/#" in link:
        say("Point a phone's camera at it. Its browser warns once, and the page explains what to tap.")


async def _run(
    options: ConsoleOptions,
    site: Site,
    sockets: tuple[Sequence[socket.socket], Sequence[socket.socket]],
    found: Sessions,
    owner: Owner,
    geometry: Geometry,
    streams: Mapping[str, Camera],
    card: str,
) -> NoReturn:
    """`sockets`: the console's, and those of the page without TLS that explains the warning to a phone."""
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    # One line: asyncio's own handler would render a traceback on the loop.
    loop.set_exception_handler(lambda _, about: _log.error("%s: %r", about.get("message"), about.get("exception")))
    pages = Pages(owner.common_name, found.revoke)
    gateway = GatewayLink(options.reach, owner.person, pages, pages.link_changed)
    stops = Stops(gateway.estop, send_stopping)
    terrain = "adapt" if options.adapt else "level"
    shared = Shared(owner.person, gateway, stops, geometry, terrain, found.new_link, options.camera_stale_ms)
    console = Console(found, pages, shared, streams, {"start": site.start_command, "link": site.link_command})
    auth = Auth(site, found)
    sys.setswitchinterval(realtime.SWITCH_INTERVAL_S)  # Zenoh's threads and those that ask share the interpreter
    serving = asyncio.create_task(HttpListener(site.tls, auth.answer, console.serve).serve(sockets[0]))
    explaining = asyncio.create_task(HttpListener(None, phone.explain, console.serve).serve(sockets[1]))
    watching = asyncio.create_task(gateway.run())
    for each in (serving, watching):
        each.add_done_callback(lambda _: ended.set())
    realtime.freeze_gc()
    say(f"For a{'nother' if os.isatty(1) else ''} browser: {site.link_command}")
    if os.isatty(1):  # a journal, or another reader of this output, would keep a link and show it to others
        show(found.new_link(card))
    else:
        say(f"The console is at {site.url}")
    shown = _opened(site, found, card) if options.open_browser else nullcontext()
    # Not by the loop's own handlers of signals, which Windows does not have.
    with on_end_signals(lambda: loop.call_soon_threadsafe(ended.set)), shown:
        await ended.wait()
        ended.clear()  # a second signal does not wait for a robot that sits down
        waits = [asyncio.create_task(pages.sit()), asyncio.create_task(ended.wait())]
        await asyncio.wait(waits, timeout=SIT_S, return_when=asyncio.FIRST_COMPLETED)
        await console.close()
    failed = watching.exception() if watching.done() else None
    watching.cancel()
    explaining.cancel()
    await gateway.close()
    if stops.unconfirmed:
        hint("STOP ALL was NOT confirmed: switch the servos' power off.")
    if failed is not None:
        raise failed
    # The interpreter's own end would wait for threads that ask a gateway which does not answer.
    logs.close()
    os._exit(0)


@contextmanager
def _opened(site: Site, found: Sessions, card: str) -> Iterator[None]:
    """Open this machine's browser by a private file that leads to a link: all users can read a command's arguments."""
    file = found.path.with_suffix(".html")
    link = escape(found.new_link(card))
    content = f'<!doctype html><title>Console</title><meta http-equiv="refresh" content="0; url={link}">'
    durable.write_like_the_folder(file, content.encode(), 0o600)
    asyncio.get_running_loop().call_later(LINK_S, partial(file.unlink, missing_ok=True))
    threading.Thread(target=partial(_open, site, file), name="browser", daemon=True).start()
    try:
        yield
    finally:
        file.unlink(missing_ok=True)


def _owner(reach: Reach) -> Owner:
    config = client_config(reach.connect, reach.zenoh_config)
    certificate = get(config, "transport/link/tls/connect_certificate")
    if certificate:
        holder = certs.folder.describe(Path(certificate))
        role: Role = next((each for each in ROLES if each == holder.role.partition(".")[0]), "observer")
        return Owner(holder.name, role, holder.common_name)
    person = "root"
    with suppress(OSError, KeyError, ImportError):  # no user of that number, or Windows
        person = os.environ.get("SUDO_USER") or getpass.getuser()
    return Owner("console" if person == "root" else person, "operator", "")  # root is nobody to ask or to name


def _open(site: Site, file: Path) -> None:
    if not webbrowser.open(file.as_uri()):
        hint(f"no browser could be opened here; for a link: {site.link_command}")
