"""The pages that are signed in: their WebSockets are served here."""

import asyncio
from contextlib import suppress
from typing import Final

from aiohttp import WSCloseCode, web

from gateway import __version__
from gateway.errors import WalkError
from gateway.people.console.pages.page_messages import Hello
from gateway.people.console.pages.page_tasks import EndError
from gateway.people.console.pages.pages import Page, Pages, Shared
from gateway.people.console.server.listener import WebSocket
from gateway.people.console.server.sessions import Entry, Sessions
from gateway.people.walking import Robot
from gateway.people.walking.planning import lying_deg

MAX_PAGES: Final = 64
"""Open at once, as many as the gateway takes sessions."""
MAX_CLOSING: Final = 16
"""Further WebSockets, which are being closed; those beyond are rejected."""
CHECK_S: Final = 1.0
"""The period in which each page's session is checked."""
SIGNED_OUT: Final = "signed out"


class Console:
    """Serves the pages, with what they share."""

    def __init__(self, sessions: Sessions, pages: Pages, shared: Shared) -> None:
        self._sessions = sessions
        self._pages = pages
        self._shared = shared
        self._geometry = shared.geometry.model_dump(mode="json")
        self._lying: dict[int, float] = {}
        with suppress(WalkError):  # one that cannot lie
            self._lying = lying_deg(Robot(shared.geometry))
        self._open: set[WebSocket] = set()

    async def serve(self, request: web.BaseRequest, session: Entry) -> web.StreamResponse:
        """Answer a page's WebSocket; return once the WebSocket has ended."""
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

    async def close(self) -> None:
        """Close all pages. None is waited for longer than a second (`WebSocket.end`)."""
        why = WSCloseCode.SERVICE_RESTART, "the console ends"
        ends = [websocket.end(*why) for websocket in self._open if websocket.prepared]
        await asyncio.gather(*ends, return_exceptions=True)

    async def _serve_page(self, websocket: WebSocket, session: Entry, tab: str) -> None:
        """`tab`: the browser's, by a name that it gave itself: the same after a reload. Empty: it gave none."""
        tab = f"{session.sha256} {tab[:32]}" if tab.isalnum() else ""
        page = Page(self._pages.next_number(), session.role, self._shared, self._pages.former(tab))
        hello = Hello(
            role=session.role,
            person=self._shared.person,
            source=page.source,
            names=page.names,
            version=__version__,
            geometry=self._geometry,
            lying=self._lying,
            last_id=page.last_id,
        )
        self._pages.add(page)
        try:
            await websocket.put(hello.model_dump_json())
            page.go_on()
            await self._exchange(websocket, page, session)
        except (ConnectionError, TimeoutError):  # TimeoutError: it does not read, so it gets no reason
            why = ""
        except EndError as end:
            why = str(end)
        finally:
            self._pages.remove(page, tab)
            page.close()
        if why:
            await websocket.end(WSCloseCode.POLICY_VIOLATION, why)

    async def _exchange(self, websocket: WebSocket, page: Page, session: Entry) -> None:
        """Until the page is closed. Raises ConnectionError, EndError, and TimeoutError where it does not read."""
        tasks = [
            asyncio.create_task(each)
            for each in (self._receive(websocket, page), self._send(websocket, page), self._check(session))
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done():
                    task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

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
