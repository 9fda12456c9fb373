"""Who may touch the robot's state: one lock, and the loop's timers, which any owner may set.

The rule: whoever holds the lock owns the robot's state (supervisor, bus, conductor, inbox), and waits for nothing but
the bus while holding it. (And for a ring that Zenoh puts a message into: microseconds.) No owner takes another lock
that is held for longer than that, so nothing can deadlock.

Its owners are the receiver threads, each for one tick, the loop for its timers, and the service at the start and the
end. An emergency stop is noted before its thread asks for the lock. Whoever owns the state then serves it between two
commands; so it waits for one command, never for a whole tick, and nobody has to give the lock away for it.

The metrics page takes no lock: it reads numbers one by one, and a thread of low priority never keeps a Stop waiting.
"""

import asyncio
import math
import threading
from collections.abc import Callable
from typing import Final

EARLY_S: Final = 1e-6
"""The loop's timers come this early at most; what is left of the time is not worth another wakeup."""


class Ownership:
    """The lock, as a context manager. It cannot be taken twice by one thread."""

    __slots__ = ("_next", "_state")

    def __init__(self, lock: Callable[[], threading.Lock] = threading.Lock) -> None:
        self._state = lock()
        # The next in line holds it while it waits. Python's locks are not fair: a thread that releases one and takes it
        # again at once would keep all others out, and here it meets the one that was first.
        self._next = lock()

    def __enter__(self) -> None:
        with self._next:
            self._state.acquire()

    def __exit__(self, *_: object) -> None:
        self._state.release()


class OwnersTimer:
    """Calls back on the loop, as owner of the state. Whoever owns the state may set it, on any thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: Ownership, callback: Callable[[], None]) -> None:
        """To be made on the loop's thread."""
        self._loop = loop
        self._owner = owner
        self._callback = callback
        self._loop_thread = threading.get_ident()
        self._due_s = math.inf
        self._wakes_s = math.inf
        """When the loop wakes up for it, or has been told to."""
        self._handle: asyncio.TimerHandle | None = None  # only the loop's thread touches it

    @property
    def armed(self) -> bool:
        """Whether it will call back."""
        return self._due_s < math.inf

    def set(self, due_s: float) -> None:
        """Call back at `due_s` of the loop's time, and at no time set before.

        The loop is woken only for an earlier time. For a later one it wakes up early, and looks again: that happens a
        few times a second, and a wakeup from another thread would cost each command 20 µs and a change of threads.
        """
        self._due_s = due_s
        if due_s >= self._wakes_s:
            return
        if threading.get_ident() == self._loop_thread:
            self._place()
        else:
            self._wakes_s = due_s
            self._loop.call_soon_threadsafe(self._told)

    def set_in(self, delay_s: float) -> None:
        """Call back so long from now."""
        self.set(self._loop.time() + delay_s)

    def cancel(self) -> None:
        """Do not call back."""
        self._due_s = math.inf

    # ---- on the loop

    def _told(self) -> None:
        with self._owner:
            self._place()

    def _place(self) -> None:
        """As owner."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        self._wakes_s = self._due_s
        if self.armed:
            self._handle = self._loop.call_at(self._due_s, self._wake)

    def _wake(self) -> None:
        self._handle = None
        with self._owner:
            if self._due_s > self._loop.time() + EARLY_S:
                self._place()
            else:
                self._due_s = self._wakes_s = math.inf
                self._callback()
