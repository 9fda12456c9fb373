"""The client for asyncio: each call waits on a thread of its own and never blocks the loop."""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar
from weakref import WeakSet

import zenoh

from gateway.errors import LeaseLostError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.client.button import Button
from gateway.people.client.interrupts import Interrupts
from gateway.people.client.lease import Lease
from gateway.people.client.payloads import Angle
from gateway.people.client.stream import Stream
from gateway.people.client.subscriptions import KEPT_EVENTS
from gateway.people.client.twin import CallThreads, HeldTwin, Twin, on_this_loop, waits
from gateway.people.client.walk import Walk
from gateway.people.walking import Distance, WalkState
from schemas.telemetry import Ack, Event, GatewayState, Telemetry

if TYPE_CHECKING:
    from gateway.geometry import Geometry

T = TypeVar("T")

MAX_CALLS: Final = 32
"""At once; further calls wait for their turn. A Stop never does."""


class AsyncClient(Twin[Client]):
    """`Client` for asyncio, with the same names, arguments and errors; opened and closed by `async with`.

    Cancelling a call ends the wait, not the command: it may still take effect.

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
        """As `Client`; `async with` connects."""
        self._make = partial(
            Client, endpoint, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s, explain=explain
        )
        self._client: Client | None = None
        self._threads = CallThreads()
        self._turns = asyncio.Semaphore(MAX_CALLS)
        self._events: WeakSet[_Events] = WeakSet()
        self._listens = False

    async def __aenter__(self) -> Self:
        """Connect. Raises ZenohError, ConfigError."""
        self._client = await self._threads.run(self._make, too_late=Client.close)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect after all pending Stops have their answers."""
        client, self._client = self._client, None
        self._listens = False
        for events in self._events:
            events.end()
        if client is not None:
            await self._threads.run_last(client.close)

    @property
    def client(self) -> Client:
        """The blocking client behind this one. Raises ZenohError unless it is open."""
        if self._client is None:
            raise ZenohError("this client is not open; use it in an `async with`")
        return self._client

    @property
    def _own(self) -> Client:
        return self.client

    async def _run(self, function: Callable[[], T], *, stops: bool) -> T:
        if stops:
            return await self._threads.run(function, stops=True)
        async with self._turns:
            return await self._threads.run(function)

    @property
    def connected(self) -> bool:
        """See `Client.connected`."""
        return self._client is not None and self._client.connected

    @property
    def name(self) -> str:
        """See `Client.name`."""
        return self.client.name

    def stream(self, hz: float = 50) -> "AsyncStream":
        """Setpoints of a gait: `async with robot.stream(50) as stream: await stream.set(…)`; see `Client.stream`."""
        return AsyncStream(self.client.stream(hz), self._threads)

    def walk(
        self,
        gait: str = "tripod",
        geometry: "Geometry | Path | str | None" = None,
        hz: float = 50,
        *,
        terrain: str = "level",
    ) -> "AsyncWalk":
        """Velocities: `async with robot.walk() as walk: await walk.go(forward_m_s=0.1)`; see `Client.walk`."""
        return AsyncWalk(self.client.walk(gait, geometry, hz, terrain=terrain), self._threads)

    def lease(
        self,
        *,
        take: bool = False,
        wait_s: float = 0.0,
        source: str | None = None,
        on_lost: Callable[[LeaseLostError], None] | None = None,
        on_asked: Callable[[str], None] | None = None,
    ) -> "AsyncLease":
        """The right to drive: `async with robot.lease(): …`; see `Client.lease`. Callbacks run on the loop."""
        lost = None if on_lost is None else on_this_loop(on_lost)
        asked = None if on_asked is None else on_this_loop(on_asked)
        lease = self.client.lease(take=take, wait_s=wait_s, source=source, on_lost=lost, on_asked=asked)
        return AsyncLease(lease, self._threads)

    def button(self, name: str | None = None) -> "AsyncButton":
        """A stop button: `async with robot.button("kitchen") as button: …`; see `Client.button`."""
        return AsyncButton(self.client.button(name), self._threads)

    wait_ready = waits(Client.wait_ready)
    ask_for_lease = waits(Client.ask_for_lease)
    start_leg = waits(Client.start_leg)
    set_leg = waits(Client.set_leg)
    start_legs = waits(Client.start_legs)
    set_legs = waits(Client.set_legs)
    stop = waits(Client.stop, stops=True)
    estop = waits(Client.estop, stops=True)
    reset = waits(Client.reset)
    calibration = waits(Client.calibration)
    revocation = waits(Client.revocation)
    calibrate = waits(Client.calibrate)
    answerers = waits(Client.answerers)
    state = waits(Client.state)
    telemetry = waits(Client.telemetry)

    async def servo(self, servo_id: int, op: str, angle_deg: Angle | None = None) -> Ack:
        """See `Client.servo`."""
        return await self._run(partial(self.client.servo, servo_id, op, angle_deg), stops=op == "stop")

    async def ask(
        self, key: str, payload: Mapping[str, Any], *, again: bool = False, priority: zenoh.Priority | None = None
    ) -> Ack:
        """See `Client.ask`."""
        return await self._run(partial(self.client.ask, key, payload, again=again, priority=priority), stops=again)

    async def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        """See `Client.publish`."""
        self.client.publish(key, payload)

    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]":
        """Call `callback` on the loop for each published state, until the returned subscriber is undeclared."""
        return self.client.on_state(on_this_loop(callback))

    def on_event(self, callback: Callable[[Event], None]) -> "zenoh.Subscriber[None]":
        """Call `callback` on the loop for each event, until the returned subscriber is undeclared."""
        return self.client.on_event(on_this_loop(callback))

    def watch_telemetry(self, callback: Callable[[Telemetry], None]) -> "zenoh.Subscriber[None]":
        """Call `callback` on the loop with what the robot measures, until the returned subscriber is undeclared."""
        return self.client.watch_telemetry(on_this_loop(callback))

    def events(self) -> "_Events":
        """`async for event in robot.events()`: all events from now on, until the client is closed.

        At most 256 unread events are kept; the oldest are dropped first.
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


class AsyncStream(HeldTwin[Stream]):
    """`Stream` for asyncio: the same rules, errors and names; for one task at a time.

    >>> async def main():
    ...     async with AsyncClient(endpoint) as robot, robot.stream(hz=50) as stream:
    ...         for step in range(10):
    ...             await stream.set({1: (90, 45 + step, 120)})
    ...         print((await robot.state()).mode)
    >>> asyncio.run(main())
    active
    """

    @property
    def missed(self) -> int:
        """See `Stream.missed`."""
        return self._own.missed

    @property
    def is_over(self) -> bool:
        """See `Stream.is_over`."""
        return self._own.is_over

    async def set(self, angles_deg: Mapping[int, Sequence[Angle]]) -> None:
        """See `Stream.set`."""
        stream = self._own
        angles = stream.read(angles_deg)
        stream.check_open()
        due_s = stream.due_s()
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
        if stream.must_ask(angles):
            await self._run(partial(stream.send, angles), stops=True)
        else:
            stream.send(angles)

    def start_again(self) -> None:
        """See `Stream.start_again`."""
        self._own.start_again()

    def go_on_without(self, legs: Iterable[int]) -> None:
        """See `Stream.go_on_without`."""
        self._own.go_on_without(legs)


class AsyncLease(HeldTwin[Lease]):
    """`Lease` for asyncio: the same rules, errors and names.

    >>> async def main():
    ...     async with AsyncClient(endpoint, source="anna") as robot, robot.lease() as lease:
    ...         print((await robot.start_leg(3, 90, 45, 120)).accepted, lease.holder)
    >>> asyncio.run(main())
    True anna
    """

    hand_over = waits(Lease.hand_over)

    @property
    def held(self) -> bool:
        """See `Lease.held`."""
        return self._own.held

    @property
    def holder(self) -> str:
        """See `Lease.holder`."""
        return self._own.holder

    @property
    def verified(self) -> bool:
        """See `Lease.verified`."""
        return self._own.verified

    @property
    def lost(self) -> LeaseLostError | None:
        """See `Lease.lost`."""
        return self._own.lost

    @property
    def ttl_ms(self) -> float:
        """See `Lease.ttl_ms`."""
        return self._own.ttl_ms


class AsyncButton(HeldTwin[Button]):
    """`Button` for asyncio: the same rules, errors and names.

    >>> async def main():
    ...     async with AsyncClient(endpoint) as robot, robot.button("kitchen") as button:
    ...         print((await button.alive()).alive)
    >>> asyncio.run(main())
    1
    """

    register = waits(Button.register)
    alive = waits(Button.alive)
    press = waits(Button.press, stops=True)

    @property
    def name(self) -> str:
        """See `Button.name`."""
        return self._own.name

    @property
    def timeout_ms(self) -> float:
        """See `Button.timeout_ms`."""
        return self._own.timeout_ms


class AsyncWalk(HeldTwin[Walk]):
    """`Walk` for asyncio: the same rules, errors and names; for one task at a time.

    As there, Ctrl-C and SIGTERM make it sit down, and a second one stops it at once. Cancelling the task stops it at
    once.

    >>> async def main():
    ...     async with AsyncClient(endpoint) as robot, robot.walk(gait="ripple") as walk:
    ...         await walk.stand()
    ...         await walk.go(turn_rad_s=0.2)
    ...         print(walk.state.posture)
    >>> asyncio.run(main())
    walking
    """

    go = waits(Walk.go)
    stand = waits(Walk.stand)
    sit = waits(Walk.sit)
    start_again = waits(Walk.start_again)

    def __init__(self, own: Walk, threads: CallThreads) -> None:
        """Made by AsyncClient. @private"""
        super().__init__(own, threads)
        self._interrupts = Interrupts()

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        self._interrupts.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if isinstance(error, asyncio.CancelledError) and self._interrupts.count == 1:
                error = KeyboardInterrupt()  # at which a walk sits
            elif isinstance(error, KeyboardInterrupt) and self._interrupts.count > 1:
                error = asyncio.CancelledError()  # the second signal came before this
            await super().__aexit__(kind, error, trace)
        except (asyncio.CancelledError, KeyboardInterrupt):
            self._own.end_now()
            raise
        finally:
            self._interrupts.close()

    async def ahead(self, metres: float) -> None:
        """See `Walk.ahead`. When cancelled, the robot stands within `hold_s` and a stride."""
        await self._cover(Distance(metres, turns=False))

    async def turn(self, radians: float) -> None:
        """See `Walk.turn`. When cancelled, the robot stands within `hold_s` and a stride."""
        await self._cover(Distance(radians, turns=True))

    async def _cover(self, distance: Distance) -> None:
        # Tick by tick on the loop: a cancelled call must leave no thread that walks on.
        while (velocity := distance.next(self.state, time.monotonic())) is not None:
            await self.go(*velocity)
        await self.stand()

    def walk_as(self, gait: str) -> None:
        """See `Walk.walk_as`."""
        self._own.walk_as(gait)

    @property
    def state(self) -> WalkState:
        """See `Walk.state`."""
        return self._own.state

    @property
    def now(self) -> str:
        """See `Walk.now`."""
        return self._own.now

    @property
    def hold_s(self) -> float:
        """See `Walk.hold_s`."""
        return self._own.hold_s

    @hold_s.setter
    def hold_s(self, seconds: float) -> None:
        self._own.hold_s = seconds

    @property
    def rest_s(self) -> float:
        """See `Walk.rest_s`."""
        return self._own.rest_s

    @rest_s.setter
    def rest_s(self, seconds: float) -> None:
        self._own.rest_s = seconds


class _Events:
    """The iterator that `AsyncClient.events` returns."""

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
