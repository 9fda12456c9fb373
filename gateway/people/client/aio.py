"""The client for asyncio. Names, arguments, rules and errors are the blocking one's; calls wait on threads."""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial, wraps
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar, cast

from gateway.errors import LeaseLostError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import Lease
from gateway.people.client.lease_requests import Button
from gateway.people.client.pace import Jitter
from gateway.people.client.process_end import WalkSignals
from gateway.people.client.stream import Stream
from gateway.people.client.walk import Walk
from gateway.people.walking.gait_speed import Distance
from gateway.people.walking.motion import WalkState

H = TypeVar("H", bound=AbstractContextManager[Any])
P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class Calls:
    """Runs each call on a thread. The end of the program waits for pending calls, including Stops."""

    def __init__(self) -> None:
        self._questions, self._stops = ThreadPoolExecutor(32), ThreadPoolExecutor(1000)  # a Stop never waits for others

    async def run(
        self,
        call: Callable[[], T],
        too_late: Callable[[T], object] = id,
        *,
        stops: bool = False,
        waits_on: Callable[[], bool] = bool,
    ) -> T:
        """Return the result of `call`, or raise its error.

        If cancelled, `call` continues; then `too_late` gets it. A cancellation while `waits_on()` changes nothing.
        """
        future = (self._stops if stops else self._questions).submit(call)
        on_loop = asyncio.wrap_future(future)
        while not on_loop.done():
            try:
                await asyncio.wait([on_loop])  # Python 3.14's `shield` prints errors that come after a cancellation
            except asyncio.CancelledError:
                if waits_on():
                    continue
                on_loop.add_done_callback(asyncio.Future.exception)  # else asyncio prints the error that nobody awaits
                self._stops.submit(lambda: future.exception() or too_late(future.result()))
                raise
        return on_loop.result()

    def after_stops(self, call: Callable[[], T]) -> Callable[[], T]:
        """Return a function that waits until all Stops pending now have their answers, then calls `call`."""
        # Here, on the loop: a cancellation submits to the new threads at once, and the old ones are not asked to wait
        # for what waits for them.
        stops, self._stops = self._stops, ThreadPoolExecutor(1)

        def wait_and_call() -> T:
            stops.shutdown()
            return call()

        return wait_and_call


class Twin(Generic[H]):
    """Wraps a blocking object that is used in a `with`."""

    def __init__(self, own: H | None, calls: Calls) -> None:
        """Made by AsyncClient. @private"""
        self._there, self._calls = own, calls

    @property
    def _own(self) -> H:
        if self._there is None:
            raise ZenohError("this client is not open; use it in an `async with`")
        return self._there

    async def __aenter__(self) -> Self:
        leave = partial(self._own.__exit__, asyncio.CancelledError, asyncio.CancelledError(), None)
        await self._calls.run(self._own.__enter__, lambda _: leave())
        return self

    async def __aexit__(self, *raised: Any) -> None:
        await self._calls.run(partial(self._own.__exit__, *raised), stops=True)


def same(name: str) -> Any:
    """Return a property for an attribute of the blocking object, or for its method that never waits."""
    return property(lambda twin: getattr(twin._own, name), lambda twin, value: setattr(twin._own, name, value))


def waits(
    method: Callable[Concatenate[H, P], T], *, stops: bool = False
) -> Callable[Concatenate[Twin[H], P], Coroutine[Any, Any, T]]:
    """Return the twin of a method that waits. `stops`: it may be a Stop, which never waits for questions."""

    @wraps(method)
    async def call(twin: Twin[H], /, *args: P.args, **kwargs: P.kwargs) -> T:
        asked = partial(method, twin._own, *args, **kwargs)  # first: `_own` raises before the opening
        return await twin._calls.run(asked, stops=stops)

    return call


def makes(
    method: Callable[Concatenate[H, P], R], twin_of: Callable[[R, Calls], T]
) -> Callable[Concatenate[Twin[H], P], T]:
    """Return the twin of a method that does not wait. Functions among its arguments are called on the running loop."""

    def on_loop(argument: Any) -> Any:
        return partial(asyncio.get_running_loop().call_soon_threadsafe, argument) if callable(argument) else argument

    @wraps(method)
    def make(twin: Twin[H], /, *args: P.args, **kwargs: P.kwargs) -> T:
        named: Any = {name: on_loop(each) for name, each in kwargs.items()}
        return twin_of(method(twin._own, *cast("Any", map(on_loop, args)), **named), twin._calls)

    return make


def opens(make: Callable[P, Client]) -> Callable[Concatenate["AsyncClient", P], None]:
    """Return an `__init__` with the arguments of `make`; `async with` calls `make`."""

    @wraps(make.__init__)
    def init(twin: "AsyncClient", /, *args: P.args, **kwargs: P.kwargs) -> None:
        twin._there, twin._make = None, partial(make, *args, **kwargs)

    return init


class AsyncStream(Twin[Stream]):
    """`Stream` for asyncio, for one task at a time."""

    missed: int = same("missed")
    jitter: Jitter = same("jitter")
    is_over: bool = same("is_over")
    start_again: Callable[[], None] = same("start_again")
    go_on_without: Callable[[Iterable[int]], None] = same("go_on_without")
    close = waits(Stream.close, stops=True)
    set = waits(Stream.set, stops=True)
    recover = waits(Stream.recover)

    async def open(self) -> Self:
        """See `Stream.open`."""
        return await self.__aenter__()


class AsyncLease(Twin[Lease]):
    """`Lease` for asyncio."""

    held: bool = same("held")
    holder: str = same("holder")
    verified: bool = same("verified")
    lost: LeaseLostError | None = same("lost")
    ttl_ms: float = same("ttl_ms")
    hand_over = waits(Lease.hand_over)


class AsyncButton(Twin[Button]):
    """`Button` for asyncio."""

    name: str = same("name")
    timeout_ms: float = same("timeout_ms")
    register = waits(Button.register)
    alive = waits(Button.alive)
    press = waits(Button.press, stops=True)


class AsyncWalk(Twin[Walk]):
    """`Walk` for asyncio, for one task at a time. Cancelling the task stops the robot at once.

    The first Ctrl-C or SIGTERM makes the robot sit down, the second stops it at once. Other handlers are still called.
    """

    state: WalkState = same("state")
    now: str = same("now")
    hold_s: float = same("hold_s")
    rest_s: float = same("rest_s")
    walk_as: Callable[[str], None] = same("walk_as")
    close = waits(Walk.close, stops=True)
    go = waits(Walk.go)
    stand = waits(Walk.stand)
    sit = waits(Walk.sit)
    start_again = waits(Walk.start_again)

    async def open(self) -> Self:
        """See `Walk.open`."""
        return await super().__aenter__()

    async def __aenter__(self) -> Self:
        await self.open()
        self._signals = WalkSignals(self._own.end_now).begin()
        return self

    async def __aexit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        by_signal = self._signals.count == 1 and isinstance(error, asyncio.CancelledError)
        if by_signal:
            error = KeyboardInterrupt()  # at which a walk sits
        with self._signals.end():
            leave = partial(self._own.__exit__, kind, error, trace)
            # The end of a loop cancels all tasks, and a task group its own again: twice for one signal.
            await self._calls.run(leave, stops=True, waits_on=lambda: by_signal and self._signals.count == 1)

    async def ahead(self, metres: float) -> None:
        """See `Walk.ahead`. When cancelled, the robot stands within `hold_s` and a stride."""
        await self._cover(Distance(metres, turns=False))

    async def turn(self, radians: float) -> None:
        """See `Walk.turn`, and `ahead` for a cancellation."""
        await self._cover(Distance(radians, turns=True))

    async def _cover(self, distance: Distance) -> None:
        # On the loop: a thread would keep walking after a cancellation, and after the end of the loop.
        while (velocity := distance.next(self.state, asyncio.get_running_loop().time())) is not None:
            await self.go(*velocity)
        await self.stand()


class AsyncClient(Twin[Client]):
    """`Client` for asyncio; opened and closed by `async with`.

    Cancelling a call ends the wait, not the command: the command may still take effect. Callbacks run on the loop.
    """

    _make: Callable[[], Client]
    __init__ = opens(Client)

    async def __aenter__(self) -> Self:
        self._calls = Calls()
        self._there = await self._calls.run(self._make, Client.close)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect after all pending Stops have their answers."""
        if self._there is not None:
            await self._calls.run(self._calls.after_stops(self._there.close))

    name: str = same("name")
    connected: bool = same("connected")
    stream = makes(Client.stream, AsyncStream)
    walk = makes(Client.walk, AsyncWalk)
    lease = makes(Client.lease, AsyncLease)
    button = makes(Client.button, AsyncButton)
    on_state = makes(Client.on_state, lambda subscriber, _: subscriber)
    on_event = makes(Client.on_event, lambda subscriber, _: subscriber)
    on_frame = makes(Client.on_frame, lambda subscriber, _: subscriber)
    on_telemetry = makes(Client.on_telemetry, lambda subscriber, _: subscriber)
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
    ask = waits(Client.ask, stops=True)
    state = waits(Client.state)
    telemetry = waits(Client.telemetry)
