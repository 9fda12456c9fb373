"""The console's one Zenoh session: what it receives goes to the event loop, newest first; what waits runs on threads.

The threads exist from the beginning, four of them for STOP ALL and four for other Stops alone: whatever else waits, or
has taken all that the system allows, a Stop finds one.
"""

import asyncio
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from gateway.errors import UnreachedError, ZenohError
from gateway.host.descriptors import Spare
from gateway.people.client.blocking import Client
from gateway.people.client.confirmed_stop import AT_ONCE
from gateway.people.client.live import Live, OnLoop, Receiver, set_upright
from gateway.people.client.silence import LOOK_S
from gateway.people.console.messages import LinkMessage
from gateway.people.console.presence import Presence
from gateway.people.tools import why
from schemas.telemetry import Ack, BodyReport, Event, GatewayState

T = TypeVar("T")

STOPS_AT_ONCE: Final = 4
"""Stops of single legs; more of them wait for one that is answered, or given up after the timeout."""
QUESTIONS_AT_ONCE: Final = 12
"""Everything else: commands, the lease, the state."""
STACK_BYTES: Final = 1_048_576
"""Of each thread that Python starts; the system's 8 MB count as memory (`LimitDATA`), though nobody uses them."""
_START_S: Final = 10.0


class Threads:
    """So many, all of them started; what they are asked for beyond that waits for its turn."""

    def __init__(self, count: int, name: str) -> None:
        """Raises RuntimeError where the system does not allow so many."""
        self.executor = ThreadPoolExecutor(count, thread_name_prefix=name)
        together = threading.Barrier(count + 1)
        for _ in range(count):
            self.executor.submit(together.wait, _START_S)
        together.wait(_START_S)

    async def run(self, function: Callable[[], T]) -> T:
        """What it returns or raises. Cancelled, it goes on."""
        return await asyncio.get_running_loop().run_in_executor(self.executor, function)


class Listener(Receiver):
    """Receives, on the event loop, what the gateway publishes."""

    def link_changed(self, link: LinkMessage) -> None:
        """The link has changed. A page stops driving by itself 500 ms after the newest state."""


class GatewayLink(Receiver):
    """`Live` on an event loop, and whether the gateway is there."""

    def __init__(
        self, connect: str | None, zenoh_config: Path | None, source: str, timeout_s: float, listener: Listener
    ) -> None:
        """`connect` and `zenoh_config` as for `Client`; `source` is whom the gateway names for an emergency stop."""
        self._connect = partial(Client, connect, zenoh_config=zenoh_config, timeout_s=timeout_s, explain=False)
        self._stop_all = Threads(AT_ONCE, "STOP ALL")
        self._stops = Threads(STOPS_AT_ONCE, "Stops")
        self._questions = Threads(QUESTIONS_AT_ONCE, "ask")
        loop = asyncio.get_running_loop()
        loop.set_default_executor(self._questions.executor)
        self._spare = Spare()
        self._listener = listener
        self._live = Live(
            partial(self._connect, source=source),
            OnLoop(loop, self),
            partial(_why, connect, zenoh_config),
        )
        self._opened = asyncio.Event()
        self._failed: asyncio.Future[None] = loop.create_future()
        self._presence = Presence()
        self._announced = self._presence.link

    # ---- what pages send

    def client(self) -> Client:
        """The one of all pages, whose questions wait on a thread. Raises ZenohError while there is no session."""
        if self._live.client is None:
            raise ZenohError("no gateway has been reached yet")
        return self._live.client

    def connect(self, source: str) -> Client:
        """A session of its own, named so; waits for it. Raises GatewayError."""
        return self._connect(source=source)

    async def ask(self, key: str, payload: Mapping[str, Any], *, again: bool) -> Ack:
        """An acknowledged command; only with `again`, for a Stop, it is sent more than once. Raises GatewayError."""
        client = self.client()
        threads = self._stops if again else self._questions
        return await threads.run(lambda: client.ask(key, payload, again=again))

    async def set_upright(self) -> Ack:
        """Put a robot that is simulated with physics on its feet. Raises GatewayError."""
        return await asyncio.to_thread(partial(set_upright, self.client()))

    async def estop(self, source: str | None) -> Ack:
        """The emergency stop, by whichever way reaches the gateway; waits for the session. Raises ZenohError.

        `source`: by whose name, if not the console's.
        """
        await self._opened.wait()
        client = self.client()
        if not client.connected:
            self._spare.give_up()  # another way to the gateway takes descriptors, and there may be no others
        try:
            return await self._stop_all.run(partial(client.estop, source))
        finally:
            self._spare.fill()

    # ---- what is received

    async def run(self) -> None:
        """Open the session and watch it, until cancelled. Raises what will not get better by waiting."""
        self._live.start()
        while not self._failed.done():
            if self._opened.is_set():
                self._watch()
            await asyncio.wait([self._failed], timeout=LOOK_S)
        self._failed.result()

    async def close(self) -> None:
        """Close the session, or give up after half a second."""
        await asyncio.to_thread(self._live.close)

    def opened(self) -> None:
        self._opened.set()
        self._presence.opened(time.monotonic_ns())

    def not_opened(self, error: Exception) -> None:
        if isinstance(error, UnreachedError):
            self._presence.not_opened(str(error))
            self._announce()
        elif not self._failed.done():
            self._failed.set_exception(error)

    def looked(self, reasons: list[str]) -> None:
        self._presence.looked(reasons)
        self._announce()

    def received_token(self, alive: bool) -> None:
        self._presence.received_token(alive)
        self._announce()

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        self._presence.received_state(received_ns)
        self._listener.received_state(state, received_ns)
        self._announce()

    def received_body(self, body: BodyReport) -> None:
        self._listener.received_body(body)

    def received_event(self, event: Event, left_out: int = 0) -> None:
        self._listener.received_event(event, left_out)

    def _watch(self) -> None:
        if self._presence.is_silent(time.monotonic_ns()):
            self._presence.fell_silent(linked=self.client().connected)
            self._announce()

    def _announce(self) -> None:
        if self._presence.link != self._announced:
            self._announced = self._presence.link
            self._listener.link_changed(self._announced)


def _why(connect: str | None, zenoh_config: Path | None, client: Client | None) -> list[str]:
    if client is None:
        return why.unreached(connect, zenoh_config)
    return why.unanswered(client, connect, zenoh_config)
