"""The console's one Zenoh session: what it hears goes to the event loop, newest first; what waits runs on threads.

The threads exist from the beginning, four of them for STOP ALL and four for other Stops alone: whatever else waits, or
has taken all that the system allows, a Stop finds one.

Zenoh delivers into rings, which threads of this module empty. Between them and the loop stand one state and at most
256 events, so neither a flood nor a busy loop takes memory.
"""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import zenoh
from pydantic import ValidationError

from gateway.errors import GatewayError, UnreachedError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.console.driving import Requests
from gateway.people.console.messages import LinkMessage
from gateway.people.console.stops import AT_ONCE
from gateway.people.console.threads import Threads
from gateway.people.tools import why
from gateway.robot.core.calibration import Calibration
from gateway.robot.core.calibration_report import calibration_of
from gateway.robot.host.descriptors import Spare
from schemas import keys
from schemas.telemetry import Ack, Event, GatewayState

OPEN_AGAIN_S: Final = 0.3
LOOK_S: Final = 0.1
"""How often the age of the newest state is looked at."""
QUIET_MS: Final = 250.0
"""After so long without a state the gateway is asked for it: it may publish none (`telemetry.state_hz = 0`)."""
ANSWER_S: Final = 0.6
SILENT_MS: Final = 1000.0
"""Without a state for so long, the link counts as silent. A page stops driving after 500 ms by itself."""
WHY_EVERY_S: Final = 3.0
"""How often it is looked why nobody is heard: each look is a connection, which costs the robot something."""
CLOSE_S: Final = 0.5
"""How long to wait for the session to close; with a frozen gateway Zenoh would take ten seconds."""
STOPS_AT_ONCE: Final = 4
"""Stops of single legs; more of them wait for one that is answered, or given up after the timeout."""
QUESTIONS_AT_ONCE: Final = 12
"""Everything else: commands, the lease, the state, why nobody answers."""
_MANY: Final = 256
_ERRORS: Final = (GatewayError, zenoh.ZError, RuntimeError)


class Listener(Protocol):
    """Hears, on the event loop, what the gateway says."""

    def heard_state(self, state: GatewayState, heard_ns: int) -> None:
        """The newest state, and when it came, by this machine's monotonic clock."""

    def heard_event(self, event: Event, left_out: int) -> None:
        """An event; before it so many were left out."""

    def heard_link(self, link: LinkMessage) -> None:
        """The link has changed."""


class GatewayLink:
    """Opens a session, trying until it succeeds; after that Zenoh itself reconnects to any of the hosts."""

    def __init__(
        self, connect: str | None, zenoh_config: Path | None, source: str, timeout_s: float, listener: Listener
    ) -> None:
        """`connect` and `zenoh_config` as for `Client`; `source` is whom the gateway names for an emergency stop."""
        self._connect = partial(Client, connect, zenoh_config=zenoh_config, timeout_s=timeout_s, explain=False)
        self._source = source
        self._client: Client | None = None
        self._stop_all = Threads(AT_ONCE, "STOP ALL")
        self._stops = Threads(STOPS_AT_ONCE, "Stops")
        self._questions = Threads(QUESTIONS_AT_ONCE, "ask")
        asyncio.get_running_loop().set_default_executor(self._questions.executor)
        self._spare = Spare()
        self._why_unreached = partial(why.unreached, connect, zenoh_config)
        self._why_unanswered = partial(why.unanswered, connect=connect, zenoh_config=zenoh_config)
        self._listener = listener
        self._open = asyncio.Event()
        self._mail = _Mail(asyncio.get_running_loop(), self._drain)
        self._subscribers: list[Any] = []
        self._link = LinkMessage(status="gone")
        self._state_ns: int | None = None
        self._ended = False
        """Whether the gateway has said good-bye since its newest state."""
        self._next_look_s = 0.0
        self._asking: asyncio.Task[None] | None = None
        self._looking: asyncio.Task[None] | None = None

    # ---- what pages send

    def client(self, source: str) -> Client:
        """A session of its own, named so; waits for it. Raises GatewayError."""
        return self._connect(source=source)

    def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        """Put a command, once; at most a millisecond, since Zenoh drops what finds no place. Raises ZenohError."""
        self._session().publish(key, payload)

    async def ask(self, key: str, payload: Mapping[str, Any], *, again: bool) -> Ack:
        """An acknowledged command; only with `again`, for a Stop, it is sent more than once. Raises GatewayError."""
        client = self._session()
        threads = self._stops if again else self._questions
        return await threads.run(lambda: client.ask(key, payload, again=again))

    def lease_requests(self) -> Requests:
        """Questions about the lease. Raises ZenohError."""
        return self._session().lease_requests

    async def calibration(self) -> Calibration:
        """What is in force. Raises GatewayError."""
        return calibration_of(await asyncio.to_thread(self._session().calibration))

    async def state(self) -> GatewayState:
        """How the robot is now. Raises GatewayError."""
        return await asyncio.to_thread(self._session().state)

    async def estop(self) -> Ack:
        """The emergency stop, by whichever way reaches the gateway; waits for the session. Raises ZenohError."""
        await self._open.wait()
        client = self._session()
        if not client.connected:
            self._spare.give_up()  # another way to the gateway takes descriptors, and there may be no others
        try:
            return await self._stop_all.run(client.estop)
        finally:
            self._spare.fill()

    def _session(self) -> Client:
        if self._client is None:
            raise ZenohError("no gateway has been reached yet")
        return self._client

    # ---- what is heard

    async def run(self) -> None:
        """Open the session and watch it, until cancelled. Raises ZenohError for what will not get better by waiting."""
        while not await self._try_to_open():
            self._look_why()
            await asyncio.sleep(OPEN_AGAIN_S)
        while True:
            self._watch()
            await asyncio.sleep(LOOK_S)

    async def close(self) -> None:
        """Close the session, or give up after `CLOSE_S`."""

        def undeclare() -> None:
            with suppress(*_ERRORS):
                for subscriber in self._subscribers:
                    subscriber.undeclare()
                if self._client is not None:
                    self._client.close()

        thread = threading.Thread(target=undeclare, name="close", daemon=True)
        thread.start()
        await asyncio.to_thread(thread.join, CLOSE_S)

    async def _try_to_open(self) -> bool:
        try:
            self._client = await asyncio.to_thread(self.client, self._source)
        except UnreachedError as error:
            self._tell("gone", self._link.detail or str(error))
            return False
        self._open.set()
        session = self._client.session
        self._listen(session.declare_subscriber(keys.STATE, zenoh.handlers.RingChannel(2)), self._mail.state)
        self._listen(session.declare_subscriber(keys.EVENT, zenoh.handlers.RingChannel(_MANY)), self._mail.event)
        alive = session.liveliness().declare_subscriber(keys.ALIVE, zenoh.handlers.RingChannel(_MANY), history=True)
        self._listen(alive, self._mail.token)
        return True

    def _listen(self, subscriber: Any, take: Callable[[zenoh.Sample], None]) -> None:
        handler = subscriber.handler

        def read() -> None:
            with suppress(*_ERRORS):  # the channel is closed
                for sample in handler:
                    with suppress(ValidationError):  # without access control, anybody may publish there
                        take(sample)

        self._subscribers.append(subscriber)
        threading.Thread(target=read, name=f"listen to {subscriber.key_expr}", daemon=True).start()

    def _drain(self) -> None:
        state, events, left_out, alive = self._mail.take()
        if alive is not None:
            self._ended = not alive
        if state is not None:
            self._heard(*state)
        for event in events:
            self._listener.heard_event(event, left_out)
            left_out = 0
        if alive is False:
            self._tell("gone", "the gateway has ended, or the link to it has")

    def _heard(self, state: GatewayState, heard_ns: int) -> None:
        if self._state_ns is not None and heard_ns < self._state_ns:
            return
        self._state_ns = heard_ns
        self._listener.heard_state(state, heard_ns)
        if not self._ended:
            self._tell("connected")

    def _watch(self) -> None:
        age_ms = float("inf") if self._state_ns is None else (time.monotonic_ns() - self._state_ns) / 1e6
        if age_ms > QUIET_MS and self._asking is None:
            self._asking = asyncio.create_task(self._ask_for_state())
        if age_ms > SILENT_MS:
            linked = self._session().connected
            if linked and not self._ended:
                self._tell("silent", self._link.detail or "the gateway is silent; it may hang")
            elif not linked:
                self._tell("gone", self._link.detail or "the link to the gateway is lost")
            self._look_why()

    async def _ask_for_state(self) -> None:
        try:
            with suppress(*_ERRORS):
                state = await asyncio.to_thread(self._session().state, ANSWER_S)
                self._ended = False
                self._heard(state, time.monotonic_ns())
        finally:
            self._asking = None

    def _look_why(self) -> None:
        if time.monotonic() >= self._next_look_s and self._looking is None:
            self._next_look_s = time.monotonic() + WHY_EVERY_S
            self._looking = asyncio.create_task(self._look())

    async def _look(self) -> None:
        try:
            with suppress(*_ERRORS):
                if self._client is not None:
                    found = await asyncio.to_thread(self._why_unanswered, self._client)
                else:
                    found = await asyncio.to_thread(self._why_unreached)
                if found and self._link.status != "connected":
                    self._tell(self._link.status, "\n".join(found))
        finally:
            self._looking = None

    def _tell(self, status: Any, detail: str = "") -> None:
        link = LinkMessage(status=status, detail=detail)
        if link != self._link:
            self._link = link
            self._listener.heard_link(link)


class _Mail:
    """What Zenoh's side has for the loop: of states only the newest, of events the newest 256."""

    def __init__(self, loop: asyncio.AbstractEventLoop, drain: Callable[[], None]) -> None:
        self._loop = loop
        self._drain = drain
        self._lock = threading.Lock()
        self._announced = False
        self._state: tuple[GatewayState, int] | None = None
        self._events: deque[Event] = deque()
        self._left_out = 0
        self._alive: bool | None = None

    def state(self, sample: zenoh.Sample) -> None:
        heard_ns = time.monotonic_ns()
        state = GatewayState.model_validate_json(sample.payload.to_bytes())
        with self._lock:
            self._state = (state, heard_ns)
            self._announce()

    def event(self, sample: zenoh.Sample) -> None:
        event = Event.model_validate_json(sample.payload.to_bytes())
        with self._lock:
            self._events.append(event)
            if len(self._events) > _MANY:
                self._events.popleft()
                self._left_out += 1
            self._announce()

    def token(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self._alive = sample.kind == zenoh.SampleKind.PUT
            self._announce()

    def take(self) -> tuple[tuple[GatewayState, int] | None, list[Event], int, bool | None]:
        """All of it, and how many events were left out before the first."""
        with self._lock:
            taken = (self._state, list(self._events), self._left_out, self._alive)
            self._announced, self._state, self._left_out, self._alive = False, None, 0, None
            self._events.clear()
        return taken

    def _announce(self) -> None:
        if not self._announced:
            self._announced = True
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._drain)
