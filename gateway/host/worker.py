"""Background threads for work that may take long. Callers never block."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from typing import TypeVar

from gateway.host.realtime import PAGE_PRIORITY, prefer_thread

T = TypeVar("T")


class Worker:
    """A thread that runs queued functions in order.

    `do` never blocks: `SimpleQueue` has no lock that a descheduled thread could hold. Starting a thread for each
    function would block the caller.
    """

    def __init__(self, name: str, priority: int | None = PAGE_PRIORITY) -> None:
        """With a `priority`, nothing preempts it while it holds the interpreter's lock (realtime.py). None: normal."""
        self._priority = priority
        self._waiting: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self.runs = True
        """False once the thread has ended, also by work that raised."""
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.thread.start()

    def do(self, work: Callable[[], object]) -> None:
        """Queue `work`, which must not raise."""
        self._waiting.put(work)

    @property
    def waiting(self) -> int:
        return self._waiting.qsize()

    def close(self, timeout_s: float | None = None) -> None:
        """Run the queue and end the thread. Blocks for `timeout_s` at most, so do not call it on the loop's thread."""
        self._waiting.put(None)
        self.thread.join(timeout_s)

    def _run(self) -> None:
        try:
            if self._priority is not None:
                prefer_thread(self._priority)
            for work in iter(self._waiting.get, None):
                work()
                del work  # releases what it refers to, such as a query whose sender waits
        finally:
            self.runs = False


def in_thread(name: str, call: Callable[[], T]) -> "asyncio.Future[T]":
    """Call it in a daemon thread: a thread of `asyncio.to_thread` would keep the process from ending."""
    loop = asyncio.get_running_loop()
    result: asyncio.Future[T] = loop.create_future()

    def run_call() -> None:
        try:
            finish = partial(result.set_result, call())
        except Exception as error:
            finish = partial(result.set_exception, error)
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            loop.call_soon_threadsafe(finish)

    threading.Thread(target=run_call, name=name, daemon=True).start()
    return result
