"""A receiver thread for each ring: it receives an item, then handles it as owner of the state."""

import asyncio
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import zenoh
from zenoh.handlers import Handler

from gateway.host.realtime import RECEIVER_PRIORITY, prefer_thread
from gateway.robot.core.message import Reply
from gateway.robot.host.disk import report_mistake
from gateway.robot.host.ownership import Ownership
from gateway.robot.zenoh_io.questions import WokenRing

OwnersTask = Callable[[], float | None]
"""Handles one item, with the state owned. Returns the seconds to wait before the next one, or None."""
Reader = Callable[[zenoh.Query, int, Reply], OwnersTask]
"""Reads one query, received at this time (ns), on a thread without the state. Returns the task for the owner."""
STUCK_BEATS: Final = 30
"""Beats without progress, 3 s. The loop owns the state in each, so a thread that only waits for the state has its turn
in between."""


class ReceiverThread:
    """A thread that takes a ring's items one by one: receive, `note`, then handle as owner of the state."""

    # mutants accepted (Forget, Step): the first look sets it
    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        owner: Ownership,
        name: str,
        ring: Handler[Any] | WokenRing,
        note: Callable[[Any, int], OwnersTask],
        *,
        priority: int = RECEIVER_PRIORITY,
    ):
        """`note(item, now_ns)` is called without the state, and returns the task for the owner of the state."""
        self._ring = ring
        self._loop = loop
        self._owner = owner
        self._note = note
        self._priority = priority
        self._in_hand_ns: int | None = None
        """When the item in hand was received; None: there is none."""
        self._seen_ns: int | None = None
        self._stuck_beats = 0
        self.thread = threading.Thread(target=self._receive, name=name, daemon=True)
        self.thread.start()

    @property
    def at_work(self) -> bool:
        """Whether the thread handles an item. Only beats show whether it is stuck."""
        return self._in_hand_ns is not None

    def makes_progress(self) -> bool:
        """Return whether the thread runs and makes progress. Call it once a beat."""
        in_hand_ns = self._in_hand_ns
        if in_hand_ns is None or in_hand_ns != self._seen_ns:
            self._stuck_beats, self._seen_ns = 0, in_hand_ns
        else:
            self._stuck_beats += 1
        return self.thread.is_alive() and self._stuck_beats < STUCK_BEATS

    def _receive(self) -> None:
        prefer_thread(self._priority)
        with suppress(zenoh.ZError):  # the ring closes with the session, which ends the thread
            while True:
                item = self._ring.recv()
                now_ns = self._in_hand_ns = time.monotonic_ns()
                pause_s = None
                try:
                    task = self._note(item, now_ns)
                    del item  # a query that is still referenced keeps its client waiting
                    with self._owner:
                        pause_s = task()
                    del task
                except Exception as error:
                    report_mistake(self._loop, f"the thread {self.thread.name} failed", error)
                self._in_hand_ns = None
                if pause_s is not None:
                    time.sleep(pause_s)
