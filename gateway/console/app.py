"""The web application: the page's files, the exchange of a link for a session, and the WebSocket."""

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway import __version__
from gateway.console.link import GatewayLink
from gateway.console.messages import Hello, Role
from gateway.console.pages import EndError, Page, Pages
from gateway.console.register import SESSION_S, Entry, Register
from gateway.console.site import Site
from gateway.console.stops import Stops
from gateway.tools.terminal import this_command

PAGE: Final = Path(__file__).with_name("page")
MAX_PAGES: Final = 64
"""Open at once, as many as the gateway takes sessions."""
SEND_S: Final = 5.0
"""How long a page may leave unread what fills its socket, before it is closed."""
CHECK_S: Final = 1.0
"""How often it is looked whether a session has ended."""
SIGNED_OUT: Final = "signed out"
POLICY_VIOLATION: Final = 1008
TRY_AGAIN_LATER: Final = 1013

CONTENT_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self' {socket}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
ANOTHER: Final = "A link that works once is printed, on the console's machine, by:"
FROM_ELSEWHERE: Final = '<!doctype html><title>Console</title><meta http-equiv="refresh" content="0; url=/">'
"""Where a link was opened from another site, such as a mail, the browser keeps back the cookie (SameSite=Strict), and
sends it with the next step that begins here."""
HEADERS: Final = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), gamepad=(self)",
    "cache-control": "no-cache",  # asked for again each time, and answered with 304 where it is the same
}


class Console:
    """What all pages share."""

    def __init__(
        self,
        site: Site,
        register: Register,
        link: GatewayLink,
        stops: Stops,
        pages: Pages,
        *,
        person: str,
        role: Role,
        geometry: Any,
    ) -> None:
        """`role` is what a page may do at most; `geometry` goes into its first message."""
        self._site = site
        self._register = register
        self._link = link
        self._pages = pages
        self._stops = stops
        self._person = person
        self._role = role
        self._geometry = geometry

    def app(self) -> ASGIApp:
        """The application, with its door."""
        routes = [
            Route("/", self._page),
            Route("/session", self._session),
            WebSocketRoute("/ws", self._websocket),
            Mount("/", StaticFiles(directory=PAGE, check_dir=False)),
        ]
        return Door(Starlette(routes=routes), self._site, self._register)

    async def _page(self, request: Request) -> Response:
        return await StaticFiles(directory=PAGE).get_response("index.html", request.scope)

    async def _session(self, request: Request) -> Response:
        entry: Entry = request.scope["session"]
        return JSONResponse({"role": self._role_of(entry), "person": self._person})

    def _role_of(self, entry: Entry) -> Role:
        return "operator" if (entry.role, self._role) == ("operator", "operator") else "observer"

    async def _websocket(self, websocket: WebSocket) -> None:
        await websocket.accept()
        if len(self._pages) >= MAX_PAGES:
            await websocket.close(TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open; close one")
            return
        entry: Entry = websocket.scope["session"]
        role = self._role_of(entry)
        page = Page(self._pages.next_number(), self._person, role, self._link, self._stops)
        hello = Hello(role=role, person=self._person, source=page.source, version=__version__, geometry=self._geometry)
        with suppress(WebSocketDisconnect):
            await websocket.send_text(hello.model_dump_json())
            self._pages.add(page)
            try:
                await self._serve(websocket, page, entry)
            finally:
                self._pages.remove(page)
                page.close()

    async def _serve(self, websocket: WebSocket, page: Page, entry: Entry) -> None:
        """Until the page is closed, or has to be."""
        tasks = [
            asyncio.create_task(each)
            for each in (self._receive(websocket, page), self._send(websocket, page), self._check(entry))
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done():
                    task.result()
        except EndError as end:
            with suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close(POLICY_VIOLATION, _reason(str(end)))
        except TimeoutError:
            pass  # it reads nothing, not even a reason; TCP gives up what it has been sent
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _receive(self, websocket: WebSocket, page: Page) -> None:
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            if text is None:
                raise EndError("a page sends text")
            page.take(text)
            await asyncio.sleep(0)  # a page that has sent much waits for the others

    async def _send(self, websocket: WebSocket, page: Page) -> None:
        while True:
            for text in await page.outgoing.wait():
                async with asyncio.timeout(SEND_S):
                    await websocket.send_text(text)

    async def _check(self, entry: Entry) -> None:
        while True:
            if not self._register.still_valid(entry):
                raise EndError(SIGNED_OUT)
            await asyncio.sleep(CHECK_S)


class Door:
    """Lets in who is signed in, at an address of ours, from our own page; turns away all others with 403.

    The session's entry is then in the scope. A link is exchanged here.
    """

    def __init__(self, app: ASGIApp, site: Site, register: Register) -> None:
        self._app = app
        self._site = site
        self._register = register

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        send = self._with_headers(scope, send)
        answer = self._answer(HTTPConnection(scope), scope)
        await (self._app if answer is None else answer)(scope, receive, send)

    def _answer(self, connection: HTTPConnection[Any], scope: Scope) -> Response | None:
        """What to say at the door; None: come in."""
        host, origin = connection.headers.get("host"), connection.headers.get("origin")
        if len(connection.headers.getlist("host")) != 1 or not self._site.knows_host(host):
            return _no(f"this console is at {self._site.url}, and not at the address that you gave")
        if (scope["type"] == "websocket" or origin is not None) and not self._site.knows_origin(origin, host):
            return _no("only the console's own page may come here")
        token = connection.query_params.get("token")
        if scope["type"] == "http" and scope["path"] == "/" and scope["method"] == "GET" and token is not None:
            return self._enter(token)
        scope["session"] = self._register.session(connection.cookies.get(self._site.cookie))
        if scope["session"] is not None:
            return None
        if scope["path"] == "/" and connection.headers.get("sec-fetch-site") == "cross-site":
            return HTMLResponse(FROM_ELSEWHERE)
        return _no(f"You are not signed in. {ANOTHER} {this_command()} console --link")

    def _enter(self, token: str) -> Response:
        found = self._register.exchange(token)
        if found is None:
            return _no(f"This link was used already, or is too old. {ANOTHER} {this_command()} console --link")
        response = RedirectResponse("/", 303)
        response.set_cookie(
            self._site.cookie,
            found[0],
            max_age=SESSION_S,
            path="/",
            secure=self._site.certificate is not None,
            httponly=True,
            samesite="strict",
        )
        return response

    def _with_headers(self, scope: Scope, send: Send) -> Send:
        host = Headers(scope=scope).get("host", "")
        socket = f"{'wss' if self._site.certificate else 'ws'}://{host}" if self._site.knows_host(host) else ""

        async def with_headers(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                headers["content-security-policy"] = CONTENT_POLICY.format(socket=socket)
            await send(message)

        return with_headers


def _no(why: str) -> Response:
    return PlainTextResponse(f"{why}\n", 403)


def _reason(text: str) -> str:
    """At most 123 bytes, which a WebSocket's close has room for."""
    return text.encode()[:123].decode(errors="ignore")
