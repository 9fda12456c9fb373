"""Asynchronous twins of blocking objects: each call waits on a thread of its own."""

import asyncio
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from contextlib import AbstractContextManager, suppress
from functools import partial, wraps
from inspect import signature
from types import TracebackType
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar

B = TypeVar("B")
H = TypeVar("H", bound=AbstractContextManager[Any])
P = ParamSpec("P")
T = TypeVar("T")


class Twin(ABC, Generic[B]):
    """Wraps a blocking object, with the same names, arguments, rules and errors."""

    _threads: "CallThreads"

    @property
    @abstractmethod
    def _own(self) -> B:
        """The blocking object."""

    async def _run(self, function: Callable[[], T], *, stops: bool) -> T:
        return await self._threads.run(function, stops=stops)


def waits(
    method: Callable[Concatenate[B, P], T], *, stops: bool = False
) -> Callable[Concatenate[Twin[B], P], Coroutine[Any, Any, T]]:
    """The twin of a method that waits. `stops`: it stops the robot, so it never waits for its turn."""

    @wraps(method)
    async def call(twin: Twin[B], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await twin._run(partial(method, twin._own, *args, **kwargs), stops=stops)

    # Documentation tools follow `__wrapped__` to the blocking method; without it they show a coroutine.
    vars(call)["__signature__"] = signature(vars(call).pop("__wrapped__"))
    return call


class HeldTwin(Twin[H]):
    """The twin of an object that is used in a `with`."""

    def __init__(self, own: H, threads: "CallThreads") -> None:
        """Made by AsyncClient. @private"""
        self._held = own
        self._threads = threads

    @property
    def _own(self) -> H:
        return self._held

    async def __aenter__(self) -> Self:
        gone = asyncio.CancelledError()
        await self._threads.run(self._own.__enter__, too_late=lambda _: self._own.__exit__(type(gone), gone, None))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The thread finishes the Stop even when this is cancelled.
        await self._threads.run(partial(self._own.__exit__, kind, error, trace), stops=True)


class CallThreads:
    """Runs each call on a thread of its own: a pool could be full when a Stop comes.

    The threads are not daemons, so the program's end waits for a pending Stop.
    """

    def __init__(self) -> None:
        self._stops: set[threading.Thread] = set()

    async def run(
        self,
        function: Callable[[], T],
        *,
        stops: bool = False,
        too_late: Callable[[T], object] | None = None,
    ) -> T:
        """Return or raise what `function` does. If cancelled, it continues, and `too_late` receives its result."""
        done: Future[T] = Future()
        done.set_running_or_notify_cancel()  # from now on it cannot be cancelled

        def call() -> None:
            try:
                result = function()
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
        """Run `function` after all pending Stops have their answers."""
        under_way = list(self._stops)

        def call() -> None:
            for thread in under_way:
                thread.join()
            function()

        await self.run(call)


def on_this_loop(callback: Callable[[T], None]) -> Callable[[T], None]:
    """`callback`, called on the running loop from any thread; not at all once the loop is closed."""
    loop = asyncio.get_running_loop()

    def call(report: T) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(callback, report)

    return call
