"""The pages that are signed in: each WebSocket that the front has admitted is served here, on one loop."""

import asyncio
from contextlib import suppress
from typing import Final

from gateway import __version__
from gateway.geometry import Geometry
from gateway.people.console.auth import SignedIn
from gateway.people.console.link import GatewayLink
from gateway.people.console.listener import Admitted
from gateway.people.console.messages import Hello
from gateway.people.console.pages import EndError, Page, Pages
from gateway.people.console.sessions import Register
from gateway.people.console.stops import Stops
from gateway.people.console.websocket import POLICY_VIOLATION, ClosedError, WebSocket

MAX_PAGES: Final = 64
"""Open at once, as many as the gateway takes sessions."""
MAX_CLOSING: Final = 16
"""WebSockets besides, which are being closed; more are ended without a word."""
SEND_S: Final = 5.0
"""How long a page may leave unread what fills its socket, before it is closed."""
CHECK_S: Final = 1.0
"""How often it is looked whether a session has ended."""
END_S: Final = 1.0
"""How long all pages together may take to learn that the console ends."""
SIGNED_OUT: Final = "signed out"
SERVICE_RESTART: Final = 1012
TRY_AGAIN_LATER: Final = 1013


class Console:
    """What all pages share."""

    def __init__(
        self,
        register: Register,
        link: GatewayLink,
        stops: Stops[str | None],
        pages: Pages,
        *,
        person: str,
        geometry: Geometry,
    ) -> None:
        """Made on the pages' loop."""
        self._register = register
        self._link = link
        self._pages = pages
        self._stops = stops
        self._person = person
        self._geometry = geometry
        self._shape = geometry.model_dump(mode="json")
        self._loop = asyncio.get_running_loop()
        self._open: dict[WebSocket, asyncio.Task[None]] = {}

    def admit(self, admitted: Admitted) -> None:
        """Serve this page. For any thread."""
        self._loop.call_soon_threadsafe(self._admit, admitted)

    async def close(self) -> None:
        """Close all pages."""
        tasks = list(self._open.values())
        for websocket in self._open:
            websocket.close(SERVICE_RESTART, "the console ends")
        if tasks:
            await asyncio.wait(tasks, timeout=END_S)

    def _admit(self, admitted: Admitted) -> None:
        if len(self._open) >= MAX_PAGES + MAX_CLOSING:
            admitted.connection.close()
            return
        websocket = WebSocket(admitted.layer, admitted.protocol)
        task = self._loop.create_task(self._serve(websocket, admitted))
        self._open[websocket] = task
        task.add_done_callback(lambda _: self._open.pop(websocket, None))

    async def _serve(self, websocket: WebSocket, admitted: Admitted) -> None:
        """From its admission until its connection has ended."""
        try:
            await self._loop.connect_accepted_socket(lambda: websocket, admitted.connection)
        except OSError:
            admitted.connection.close()
            return
        if len(self._pages) >= MAX_PAGES:
            websocket.close(TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open; close one")
        else:
            await self._serve_page(websocket, admitted.session)
        await websocket.closed.wait()

    async def _serve_page(self, websocket: WebSocket, session: SignedIn) -> None:
        page = Page(
            self._pages.next_number(),
            self._person,
            session.role,
            self._link,
            self._stops,
            self._geometry,
            self._register.new_link,
        )
        hello = Hello(
            role=session.role, person=self._person, source=page.source, version=__version__, geometry=self._shape
        )
        self._pages.add(page)
        try:
            with suppress(ClosedError):
                await websocket.send(hello.model_dump_json())
                await self._exchange(websocket, page, session)
        except EndError as end:
            websocket.close(POLICY_VIOLATION, str(end))
        except TimeoutError:
            websocket.abort()  # it reads nothing, not even a reason
        finally:
            self._pages.remove(page)
            page.close()

    async def _exchange(self, websocket: WebSocket, page: Page, session: SignedIn) -> None:
        """Until the page is closed, or has to be."""
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
            page.take(await websocket.receive())
            await asyncio.sleep(0)  # a page that has sent much waits for the others

    async def _send(self, websocket: WebSocket, page: Page) -> None:
        while True:
            for text in await page.outgoing.wait():
                async with asyncio.timeout(SEND_S):
                    await websocket.send(text)

    async def _check(self, session: SignedIn) -> None:
        while True:
            if not self._register.still_valid(session.entry):
                raise EndError(SIGNED_OUT)
            await asyncio.sleep(CHECK_S)
