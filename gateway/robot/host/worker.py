"""Work that may take long, on threads of their own: nobody waits for it, and least of all whoever owns the state."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from gateway.errors import ConfigError
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.robot.host.ownership import Ownership


class Worker:
    """A thread that does what it is given, one after the other.

    `do` never waits: `SimpleQueue` has no lock that a thread could hold while it waits for a processor, and a thread
    that is started for each piece of work would have to be waited for.
    """

    def __init__(
        self, name: str, priority: int | None = PAGE_PRIORITY, look: Callable[[], float | None] = lambda: None
    ) -> None:
        """By its `priority` it is not put aside while it holds the interpreter's lock: see realtime.py.

        `look` is called on the thread each time before it waits: in how many seconds to call it again at the latest.
        """
        self._priority = priority
        self._look = look
        self._waiting: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.thread.start()

    def do(self, work: Callable[[], object]) -> None:
        """Do this once all else is done. It must not raise."""
        self._waiting.put(work)

    @property
    def waiting(self) -> int:
        """How much is to be done yet."""
        return self._waiting.qsize()

    def close(self, timeout_s: float | None = None) -> None:
        """Do what waits, and end the thread. Blocks, for `timeout_s` at most; not for the loop's thread."""
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
            del work  # and with it what it refers to, such as a query whose asker waits


class DiskWriter:
    """A worker that writes to a disk. A write that never ends keeps its own caller waiting and nobody else."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop, owner: Ownership) -> None:
        self._loop = loop
        self._owner = owner
        self._worker = Worker(name)

    def write(self, write: Callable[[], None], then: Callable[[str | None], object]) -> None:
        """Call `write`, and then, as owner of the state, `then`: with a sentence where it raised ConfigError.

        Returns at once.
        """
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
    """As if it had happened on the loop, which ends the service after a mistake of our own. From any thread."""
    with suppress(RuntimeError):  # the loop is closed: the service has ended
        loop.call_soon_threadsafe(loop.call_exception_handler, {"message": what, "exception": error})
