"""Background threads for work that may take long; callers never block."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from gateway.errors import ConfigError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.robot.host.ownership import Ownership


class Worker:
    """A thread that runs queued functions in order.

    `do` never blocks: `SimpleQueue` has no lock that a descheduled thread could hold. Starting a thread for each
    function would block the caller.
    """

    def __init__(
        self, name: str, priority: int | None = PAGE_PRIORITY, look: Callable[[], float | None] = lambda: None
    ) -> None:
        """`priority`: so that it is not preempted while it holds the interpreter's lock (realtime.py); None: normal.

        `look` is called on the thread before each wait; it returns the maximum wait in seconds, None for no limit.
        """
        self._priority = priority
        self._look = look
        self._waiting: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.thread.start()

    def do(self, work: Callable[[], object]) -> None:
        """Queue `work`, which must not raise."""
        self._waiting.put(work)

    @property
    def waiting(self) -> int:
        """The number of queued functions."""
        return self._waiting.qsize()

    def close(self, timeout_s: float | None = None) -> None:
        """Run the queue and end the thread. Blocks for `timeout_s` at most; not for the loop's thread."""
        self._waiting.put(None)
        self.thread.join(timeout_s)

    def _run(self) -> None:
        if self._priority is not None:
            prefer_thread(self._priority)
        while True:
            try:
                work = self._waiting.get(timeout=self._look())
            except Empty:
                continue
            if work is None:
                return
            work()
            del work  # releases what it refers to, such as a query whose sender waits


class DiskWriter:
    """A background thread that writes to a disk. A write that hangs delays only further writes."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop, owner: Ownership) -> None:
        self._loop = loop
        self._owner = owner
        self._worker = Worker(name)

    def write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        """Queue `write`; afterwards call `then` as owner of the state, with the text of a ConfigError, else None."""
        self._worker.do(lambda: self._write(write, then))

    def _write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        try:
            fault = None
            try:
                write()
            except ConfigError as error:
                fault = str(error)
            with self._owner:
                then(fault)
        except Exception as error:
            report_mistake(self._loop, f"the thread {self._worker.thread.name} failed", error)


def report_mistake(loop: asyncio.AbstractEventLoop, what: str, error: Exception) -> None:
    """Pass an unexpected exception to the loop's handler, which ends the service. From any thread."""
    with suppress(RuntimeError):  # the loop is closed: the service has ended
        loop.call_soon_threadsafe(loop.call_exception_handler, {"message": what, "exception": error})
