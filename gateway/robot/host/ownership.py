"""The lock on the robot's state, and the loop's timers, which any owner of the state may set.

The rule: the thread that holds the lock owns the state (supervisor, bus, conductor, inbox). It waits only for the bus,
and for microseconds for a ring into which Zenoh puts a message. An owner takes no lock that is held for longer, so
there is no deadlock. The threads: docs/design.md, *One owner at a time*.
"""

import asyncio
import math
import threading
from collections.abc import Callable
from typing import Final

_EARLY_S: Final = 1e-6
"""The loop's timers may fire this early, which is not worth another wakeup."""


class Ownership:
    """The lock, as a context manager. Not reentrant."""

    __slots__ = ("_next", "_state")

    def __init__(self, lock: Callable[[], threading.Lock] = threading.Lock) -> None:
        self._state = lock()
        # Held by the first waiting thread. Python's locks are not fair: a thread that releases a lock and takes it
        # again at once would starve all others; here it queues behind the first.
        self._next = lock()

    def __enter__(self) -> None:
        with self._next:
            self._state.acquire()

    def __exit__(self, *_: object) -> None:
        self._state.release()


class OwnersTimer:
    """Calls back on the loop, as owner of the state. Any owner may set it, from any thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: Ownership, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._owner = owner
        self._callback = callback
        self._due_s = math.inf
        self._wakes_s = math.inf
        """When the loop wakes up for this timer."""
        self._handle: asyncio.TimerHandle | None = None  # only the loop's thread touches it

    @property
    def armed(self) -> bool:
        return self._due_s < math.inf

    def set(self, due_s: float) -> None:  # mutants accepted (Lt_LtE): equal times
        """Call back at `due_s` of the loop's clock, instead of the time set before.

        Only an earlier time wakes the loop. For a later one, it wakes up at the old time and sets the timer again. That
        happens a few times a second; waking it from another thread would cost each command 20 µs and a context switch.
        """
        self._due_s = due_s
        if due_s < self._wakes_s:
            self._wakes_s = due_s
            self._loop.call_soon_threadsafe(self._wake)

    def set_in(self, delay_s: float) -> None:
        self.set(self._loop.time() + delay_s)

    def cancel(self) -> None:
        self._due_s = math.inf

    def _wake(self) -> None:  # mutants accepted (Forget, Gt_GtE): equal times; a wakeup too many
        """Call back if it is due, else wake up again when it will be."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        with self._owner:
            due_s, self._wakes_s = self._due_s, self._due_s
            if due_s <= self._loop.time() + _EARLY_S:
                self._due_s = self._wakes_s = math.inf
                self._callback()
            elif due_s < math.inf:
                self._handle = self._loop.call_at(due_s, self._wake)
