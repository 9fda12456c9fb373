"""The pages that are signed in: each WebSocket that the listener has admitted is served here, on one loop."""

import asyncio
from contextlib import suppress
from typing import Final

from gateway import __version__
from gateway.errors import WalkError
from gateway.people.console.pages.page_messages import Hello
from gateway.people.console.pages.page_tasks import EndError
from gateway.people.console.pages.pages import Page, Pages, Shared
from gateway.people.console.server.auth import SignedIn
from gateway.people.console.server.listener import Admitted
from gateway.people.console.server.sessions import Sessions
from gateway.people.console.server.websocket import POLICY_VIOLATION, ClosedError, WebSocket
from gateway.people.walking import Robot
from gateway.people.walking.planning import lying_deg

MAX_PAGES: Final = 64
"""Open at once, as many as the gateway takes sessions."""
MAX_CLOSING: Final = 16
"""Further WebSockets, which are being closed; those beyond are ended without a reason."""
SEND_S: Final = 5.0
"""A page that does not read for so long, while its socket is full, is closed."""
CHECK_S: Final = 1.0
"""How often each page's session is checked for its end."""
CLOSE_PAGES_S: Final = 1.0
"""How long all pages together may take to receive that the console ends."""
SIGNED_OUT: Final = "signed out"
SERVICE_RESTART: Final = 1012
TRY_AGAIN_LATER: Final = 1013


class Console:
    """Serves the pages, with what they share."""

    def __init__(self, sessions: Sessions, pages: Pages, shared: Shared) -> None:
        """Made on the pages' loop."""
        self._sessions = sessions
        self._pages = pages
        self._shared = shared
        self._geometry = shared.geometry.model_dump(mode="json")
        self._lying: dict[int, float] = {}
        with suppress(WalkError):  # one that cannot lie
            self._lying = lying_deg(Robot(shared.geometry))
        self._loop = asyncio.get_running_loop()
        self._open: dict[WebSocket, asyncio.Task[None]] = {}

    def admit(self, admitted: Admitted) -> None:
        """Serve this page. For any thread."""
        self._loop.call_soon_threadsafe(self._admit, admitted)

    async def close(self) -> None:
        """Close all pages, and wait for them up to CLOSE_PAGES_S."""
        tasks = list(self._open.values())
        for websocket in self._open:
            websocket.close(SERVICE_RESTART, "the console ends")
        if tasks:
            await asyncio.wait(tasks, timeout=CLOSE_PAGES_S)

    def _admit(self, admitted: Admitted) -> None:
        if len(self._open) >= MAX_PAGES + MAX_CLOSING:
            admitted.connection.close()
            return
        websocket = WebSocket(admitted.layer, admitted.protocol)
        task = self._loop.create_task(self._serve(websocket, admitted))
        self._open[websocket] = task
        task.add_done_callback(lambda _: self._open.pop(websocket, None))

    async def _serve(self, websocket: WebSocket, admitted: Admitted) -> None:
        """Until its connection has ended."""
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
        tab = session.tab and f"{session.entry.sha256} {session.tab[:32]}"
        page = Page(self._pages.next_number(), session.role, self._shared, self._pages.former(tab))
        hello = Hello(
            role=session.role,
            person=self._shared.person,
            source=page.source,
            version=__version__,
            geometry=self._geometry,
            lying=self._lying,
            last_id=page.last_id,
        )
        self._pages.add(page)
        try:
            with suppress(ClosedError):
                await websocket.send(hello.model_dump_json())
                page.go_on()
                await self._exchange(websocket, page, session)
        except EndError as end:
            websocket.close(POLICY_VIOLATION, str(end))
        except TimeoutError:
            websocket.abort()  # it does not read, so it gets no reason
        finally:
            self._pages.remove(page, tab)
            page.close()

    async def _exchange(self, websocket: WebSocket, page: Page, session: SignedIn) -> None:
        """Until the page is closed. Raises EndError where it has to be, and TimeoutError where it does not read."""
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
            await asyncio.sleep(0)  # lets the other pages go first

    async def _send(self, websocket: WebSocket, page: Page) -> None:
        while True:
            for text in await page.outgoing.wait():
                async with asyncio.timeout(SEND_S):
                    await websocket.send(text)

    async def _check(self, session: SignedIn) -> None:
        while True:
            if not self._sessions.still_valid(session.entry):
                raise EndError(SIGNED_OUT)
            await asyncio.sleep(CHECK_S)
