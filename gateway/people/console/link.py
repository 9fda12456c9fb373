"""The console's one Zenoh session: hands what it receives to the event loop, and asks the gateway on threads.

All threads are started at the beginning, four of them for STOP ALL alone and four for other Stops: so a Stop finds one
even if everything else waits, or has taken all that the system allows.

The console uses the blocking client: `AsyncClient` starts a thread when a call needs one, up to a thousand for what may
be a Stop, and the console's service may have 128 (TasksMax).
"""

import asyncio
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal

from gateway.errors import UnreachedError, ZenohError
from gateway.geometry import Geometry
from gateway.host.descriptors import Spare
from gateway.people.client.blocking import Client
from gateway.people.commands import why
from gateway.people.commands.options import Reach
from gateway.people.console.pages.page_messages import Message, link_message
from gateway.people.console.pages.page_tasks import Stops
from gateway.people.watching.confirmed_stop import REQUESTS_AT_ONCE
from gateway.people.watching.live import Live, OnLoop, Receiver
from gateway.people.watching.silence import CHECK_EVERY_S
from schemas.ack import Ack
from schemas.gateway_state import GatewayState

STOPS_AT_ONCE: Final = 4
"""Stops of single legs; further ones wait until one is answered, or given up after the timeout."""
PAGE_QUESTIONS_AT_ONCE: Final = 12
"""All other questions, on the loop's own executor: commands, the lease, the state."""
STACK_BYTES: Final = 1_048_576
"""Stack of each thread that Python starts. The system's 8 MB would count as memory (`LimitDATA`), even if unused."""
THREADS_START_S: Final = 10.0


def ready_threads(count: int, name: str) -> ThreadPoolExecutor:
    """Return an executor whose threads are all started; further calls wait for a free one.

    Raises RuntimeError if the system does not allow `count` threads.
    """
    executor = ThreadPoolExecutor(count, thread_name_prefix=name)
    together = threading.Barrier(count + 1)
    for _ in range(count):
        executor.submit(together.wait, THREADS_START_S)
    together.wait(THREADS_START_S)
    return executor


class GatewayLink(Receiver):
    """`Live` on an event loop, with the link's status."""

    def __init__(self, reach: Reach, source: str, receiver: Receiver, link_changed: Callable[[Message], None]) -> None:
        """`source` is the name of the console's emergency stops. `receiver` and `link_changed` are called on the loop.

        A page stops driving by itself 500 ms after the newest state.
        """
        connect, zenoh_config, timeout_s = reach
        self.connect = partial(Client, connect, zenoh_config=zenoh_config, timeout_s=timeout_s, explain=False)
        """Opens another session, named `source`; blocks. Raises GatewayError if the gateway cannot be reached."""
        self._stop_all = ready_threads(REQUESTS_AT_ONCE, "STOP ALL")
        self._stops = ready_threads(STOPS_AT_ONCE, "Stops")
        self._loop = loop = asyncio.get_running_loop()
        loop.set_default_executor(ready_threads(PAGE_QUESTIONS_AT_ONCE, "ask"))
        self._spare = Spare()
        self._link_changed = link_changed
        reasons = partial(why.unanswered, connect=connect, zenoh_config=zenoh_config)
        self._live = Live(partial(self.connect, source=source), OnLoop(loop, self, receiver), reasons)
        self._opened = asyncio.Event()
        self._failed: asyncio.Future[None] = loop.create_future()
        self._link = link_message("gone")
        """The newest message to the pages about the link."""
        self._ended = False
        """Whether the gateway's liveliness token is gone."""

    # ---- what pages send

    def client(self) -> Client:
        """Return the client of all pages; its requests block. Raises ZenohError while there is no session."""
        if self._live.client is None:
            raise ZenohError("no gateway has been reached yet")
        return self._live.client

    async def ask(self, key: str, payload: Mapping[str, Any], *, again: bool) -> Ack:
        """Send a command and return its Ack. `again` (Stops only): repeat it until answered. Raises GatewayError."""
        ask = partial(self.client().ask, key, payload, again=again)
        return await self._loop.run_in_executor(self._stops if again else None, ask)

    async def estop(self, source: str) -> Ack:
        """Wait for the session, then request the emergency stop by any way that reaches the gateway. Raises ZenohError.

        `source`: the page or button that requests it.
        """
        await self._opened.wait()
        client = self.client()
        if not client.connected:
            self._spare.give_up()  # another way to the gateway needs descriptors, and none may be left
        try:
            return await self._loop.run_in_executor(self._stop_all, client.estop, source)
        finally:
            self._spare.fill()

    # ---- what is received

    async def run(self) -> None:
        """Open the session and watch it, until cancelled. Raises errors that waiting does not resolve."""
        self._live.start()
        while not self._failed.done():
            if self._opened.is_set() and self._live.is_silent(time.monotonic_ns()):
                self.fell_silent(linked=self.client().connected)
            await asyncio.wait([self._failed], timeout=CHECK_EVERY_S)
        self._failed.result()

    async def close(self) -> None:
        """Close the session, or give up after half a second."""
        await asyncio.to_thread(self._live.close)

    def opened(self) -> None:
        self._opened.set()

    def not_opened(self, error: Exception) -> None:
        if isinstance(error, UnreachedError):
            self._announce("gone", self._link["detail"] or str(error))
        elif not self._failed.done():
            self._failed.set_exception(error)

    def diagnosed(self, reasons: list[str]) -> None:
        if self._link["status"] != "connected":
            self._announce(self._link["status"], "\n".join(reasons))

    def received_token(self, alive: bool) -> None:
        self._ended = not alive
        if not alive:
            self._announce("gone", "the gateway has ended, or the link to it has")

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        del state, received_ns  # the pages' own
        if not self._ended:  # after that a late state does not reconnect the link
            self._announce("connected")

    def fell_silent(self, *, linked: bool) -> None:
        """Record a long silence. `linked`: connected to the gateway or to a router in front of it."""
        if not linked:
            self._announce("gone", self._link["detail"] or "the link to the gateway is lost")
        elif not self._ended:
            self._announce("silent", self._link["detail"] or "the gateway is silent; it may hang")

    def _announce(self, status: Literal["connected", "silent", "gone"], detail: str = "") -> None:
        message = link_message(status, detail)
        if message != self._link:
            self._link = message
            self._link_changed(message)


@dataclass(frozen=True)
class Shared:
    """What all pages of a console use. `new_link` writes a file, so a thread calls it."""

    person: str
    link: GatewayLink
    stops: Stops[str]
    geometry: Geometry
    terrain: str
    """The terrain of every page's walk."""
    new_link: Callable[[], str]
    stale_ms: float = 0.0
    """Of a page that shows a camera: an older picture moves nothing; 0: any moves."""
