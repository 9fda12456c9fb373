"""The same for asyncio: each question waits on a thread of its own, and the loop waits for nobody."""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar
from weakref import WeakSet

import zenoh

from gateway.errors import GatewayError, LeaseLostError, ZenohError
from gateway.people.client.aio_button import AsyncButton
from gateway.people.client.aio_lease import AsyncLease
from gateway.people.client.blocking import Client
from gateway.people.client.payloads import Angle
from gateway.people.client.stream import Stream
from schemas.telemetry import Ack, Event, GatewayState

if TYPE_CHECKING:
    from gateway.geometry import Geometry
    from gateway.people.client.aio_walk import AsyncWalk
    from schemas.calibration import Calibration, ServoChange
    from schemas.lease import LeaseAck
    from schemas.revocation import RevocationAck

T = TypeVar("T")

MAX_QUESTIONS: Final = 32
"""At once; whoever asks more waits for its turn. A Stop never does."""
KEPT_EVENTS: Final = 256
"""For an `events()` that is not read; the oldest make way."""


class AsyncClient:
    """`Client` for asyncio, with the same names, arguments and errors; opened and closed by `async with`.

    Whoever cancels a call no longer waits for its answer; what was asked may take effect all the same.

    >>> async def main():
    ...     async with AsyncClient(endpoint, source="an example") as robot:
    ...         print((await robot.start_leg(3, 90, 45, 120)).accepted)
    ...         print((await robot.stop()).accepted)
    >>> asyncio.run(main())
    True
    True
    """

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        zenoh_config: str | Path | None = None,
        source: str | None = None,
        timeout_s: float = 2.0,
        explain: bool = True,
    ) -> None:
        """As `Client`; nothing is opened yet."""
        self._make = lambda: Client(
            endpoint, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s, explain=explain
        )
        self._client: Client | None = None
        self._threads = _Threads()
        self._turns = asyncio.Semaphore(MAX_QUESTIONS)
        self._events: WeakSet[_Events] = WeakSet()
        self._listens = False

    async def __aenter__(self) -> Self:
        """Connect. Raises ZenohError, ConfigError."""
        self._client = await self._threads.run(self._make, too_late=Client.close)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect, once what is under way (a Stop) has its answer."""
        client, self._client = self._client, None
        self._listens = False
        for events in self._events:
            events.end()
        if client is not None:
            await self._threads.run_last(client.close)

    @property
    def client(self) -> Client:
        """The one behind it. Raises ZenohError where it is not open."""
        if self._client is None:
            raise ZenohError("this client is not open; use it in an `async with`")
        return self._client

    @property
    def connected(self) -> bool:
        """See `Client.connected`."""
        return self._client is not None and self._client.connected

    @property
    def name(self) -> str:
        """See `Client.name`."""
        return self.client.name

    async def wait_ready(self, timeout_s: float = 10.0) -> GatewayState:
        """See `Client.wait_ready`."""
        return await self._ask(self.client.wait_ready, timeout_s)

    def stream(self, hz: float = 50) -> "AsyncStream":
        """Setpoints of a gait: `async with robot.stream(50) as stream: await stream.set(…)`; see `Client.stream`."""
        return AsyncStream(self.client.stream(hz), self._threads)

    def walk(
        self, gait: str = "tripod", geometry: "Geometry | Path | str | None" = None, hz: float = 50
    ) -> "AsyncWalk":
        """Velocities: `async with robot.walk() as walk: await walk.go(forward_m_s=0.1)`; see `Client.walk`."""
        from gateway.people.client.aio_walk import AsyncWalk

        return AsyncWalk(self.client.walk(gait, geometry, hz), self._threads.run)

    def lease(
        self,
        *,
        take: bool = False,
        wait_s: float = 0.0,
        source: str | None = None,
        on_lost: Callable[[LeaseLostError], None] | None = None,
        on_asked: Callable[[str], None] | None = None,
    ) -> AsyncLease:
        """The right to drive: `async with robot.lease(): …`; see `Client.lease`. It calls back on the loop."""
        lost = None if on_lost is None else _on_this_loop(on_lost)
        asked = None if on_asked is None else _on_this_loop(on_asked)
        lease = self.client.lease(take=take, wait_s=wait_s, source=source, on_lost=lost, on_asked=asked)
        return AsyncLease(lease, self._threads.run)

    async def ask_for_lease(self, source: str | None = None) -> "LeaseAck":
        """See `Client.ask_for_lease`."""
        return await self._ask(self.client.ask_for_lease, source)

    def button(self, name: str | None = None) -> AsyncButton:
        """A stop button: `async with robot.button("kitchen") as button: …`; see `Client.button`."""
        return AsyncButton(self.client.button(name), self._threads.run)

    async def start_leg(self, leg: int, *angles_deg: Angle | Sequence[Angle]) -> Ack:
        """See `Client.start_leg`."""
        return await self._ask(self.client.start_leg, leg, *angles_deg)

    async def set_leg(self, leg: int, *angles_deg: Angle | Sequence[Angle]) -> Ack:
        """See `Client.set_leg`."""
        return await self._ask(self.client.set_leg, leg, *angles_deg)

    async def start_legs(self, angles_deg: Mapping[int, Sequence[Angle]]) -> Ack:
        """See `Client.start_legs`."""
        return await self._ask(self.client.start_legs, angles_deg)

    async def set_legs(self, angles_deg: Mapping[int, Sequence[Angle]]) -> Ack:
        """See `Client.set_legs`."""
        return await self._ask(self.client.set_legs, angles_deg)

    async def stop(self, leg: int | None = None) -> Ack:
        """See `Client.stop`."""
        return await self._stop(self.client.stop, leg)

    async def servo(self, servo_id: int, op: str, angle_deg: Angle | None = None) -> Ack:
        """See `Client.servo`."""
        if op == "stop":
            return await self._stop(self.client.servo, servo_id, op, angle_deg)
        return await self._ask(self.client.servo, servo_id, op, angle_deg)

    async def estop(self, source: str | None = None) -> Ack:
        """See `Client.estop`."""
        return await self._stop(self.client.estop, source)

    async def reset(self, estop: int | None = None) -> Ack:
        """See `Client.reset`."""
        return await self._ask(self.client.reset, estop)

    async def calibration(self) -> "Calibration":
        """See `Client.calibration`."""
        return await self._ask(self.client.calibration)

    async def revocation(self, revoked: str | None = None) -> "RevocationAck":
        """See `Client.revocation`."""
        return await self._ask(self.client.revocation, revoked)

    async def calibrate(
        self,
        servos: "Mapping[int, ServoChange]" = MappingProxyType({}),
        landing: Mapping[int, Angle | None] = MappingProxyType({}),
        *,
        revision: int | None = None,
        accept_default: bool = False,
    ) -> Ack:
        """See `Client.calibrate`."""
        calibrate = self.client.calibrate
        return await self._ask(lambda: calibrate(servos, landing, revision=revision, accept_default=accept_default))

    async def ask(
        self, key: str, payload: Mapping[str, Any], *, again: bool = False, priority: zenoh.Priority | None = None
    ) -> Ack:
        """See `Client.ask`."""
        run = self._stop if again else self._ask
        return await run(lambda: self.client.ask(key, payload, again=again, priority=priority))

    async def answerers(self, key: str, wait_s: float = 0.0) -> frozenset[str]:
        """See `Client.answerers`."""
        return await self._ask(self.client.answerers, key, wait_s)

    async def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        """See `Client.publish`."""
        self.client.publish(key, payload)

    async def state(self, timeout_s: float | None = None) -> GatewayState:
        """See `Client.state`."""
        return await self._ask(self.client.state, timeout_s)

    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]":
        """Call back, on the loop, for each published state, until the returned subscriber is undeclared."""
        return self.client.on_state(_on_this_loop(callback))

    def on_event(self, callback: Callable[[Event], None]) -> "zenoh.Subscriber[None]":
        """Call back, on the loop, for each event."""
        return self.client.on_event(_on_this_loop(callback))

    def events(self) -> "_Events":
        """`async for event in robot.events()`: all events from now on, until the client is closed.

        What is not read is kept, but for no more than 256 events, of which the oldest make way.
        """
        events = _Events()
        self._events.add(events)
        if not self._listens:
            self._listens = True
            self.on_event(self._publish)
        return events

    def _publish(self, event: Event) -> None:
        for events in list(self._events):
            events.add(event)

    async def _ask(self, function: Callable[..., T], *args: object) -> T:
        async with self._turns:
            return await self._threads.run(function, *args)

    async def _stop(self, function: Callable[..., T], *args: object) -> T:
        return await self._threads.run(function, *args, stops=True)


class AsyncStream:
    """`Stream` for asyncio: the same rules, errors and names; for one task at a time.

    >>> async def main():
    ...     async with AsyncClient(endpoint) as robot, robot.stream(hz=50) as stream:
    ...         for step in range(10):
    ...             await stream.set({1: (90, 45 + step, 120)})
    ...         print((await robot.state()).mode)
    >>> asyncio.run(main())
    active
    """

    def __init__(self, stream: Stream, threads: "_Threads") -> None:
        """Made by `AsyncClient.stream`."""
        self._stream = stream
        self._threads = threads

    @property
    def missed(self) -> int:
        """See `Stream.missed`."""
        return self._stream.missed

    @property
    def is_over(self) -> bool:
        """See `Stream.is_over`."""
        return self._stream.is_over

    async def __aenter__(self) -> Self:
        await self._threads.run(self._stream.open, too_late=lambda _: self._stream.close())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._threads.run(self._stream.close, stops=True)  # goes on when this is cancelled
        except GatewayError as failed:
            if error is None:
                raise
            error.add_note(f"and the Stop at the end of the stream: {failed}")

    async def set(self, angles_deg: Mapping[int, Sequence[Angle]]) -> None:
        """See `Stream.set`."""
        stream = self._stream
        angles = stream.read(angles_deg)
        stream.check_open()
        due_s = stream.due_s()
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
        if stream.must_ask(angles):
            await self._threads.run(stream.send, angles, stops=True)
        else:
            stream.send(angles)

    def start_again(self) -> None:
        """See `Stream.start_again`."""
        self._stream.start_again()

    def go_on_without(self, legs: Iterable[int]) -> None:
        """See `Stream.go_on_without`."""
        self._stream.go_on_without(legs)


class _Events:
    """What `AsyncClient.events` returns."""

    def __init__(self) -> None:
        self._kept: deque[Event] = deque(maxlen=KEPT_EVENTS)
        self._there = asyncio.Event()
        self._ended = False

    def add(self, event: Event) -> None:
        self._kept.append(event)
        self._there.set()

    def end(self) -> None:
        self._ended = True
        self._there.set()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        while not self._kept:
            if self._ended:
                raise StopAsyncIteration
            self._there.clear()
            await self._there.wait()
        return self._kept.popleft()


class _Threads:
    """Runs what waits, each call on a thread of its own: no pool in which a Stop could be the one too many.

    They are no daemons: a program's end waits for a Stop that is under way.
    """

    def __init__(self) -> None:
        self._stops: set[threading.Thread] = set()

    async def run(
        self,
        function: Callable[..., T],
        *args: object,
        stops: bool = False,
        too_late: Callable[[T], object] | None = None,
    ) -> T:
        """What `function` returns or raises. Cancelled, it goes on, and `too_late` takes what it then returns."""
        done: Future[T] = Future()
        done.set_running_or_notify_cancel()  # from now on nobody can cancel it

        def call() -> None:
            try:
                result = function(*args)
            except BaseException as error:
                done.set_exception(error)
            else:
                done.set_result(result)
            finally:
                self._stops.discard(threading.current_thread())

        thread = threading.Thread(target=call, name="ask the gateway")
        if stops:
            self._stops.add(thread)
        thread.start()
        try:
            return await asyncio.wrap_future(done)
        except asyncio.CancelledError:
            if too_late is not None:
                take = too_late
                threading.Thread(target=lambda: done.exception() or take(done.result())).start()
            raise

    async def run_last(self, function: Callable[[], None]) -> None:
        """The same, when all Stops have their answers."""
        under_way = list(self._stops)

        def call() -> None:
            for thread in under_way:
                thread.join()
            function()

        await self.run(call)


def _on_this_loop(callback: Callable[[T], None]) -> Callable[[T], None]:
    loop = asyncio.get_running_loop()

    def call(report: T) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(callback, report)

    return call
