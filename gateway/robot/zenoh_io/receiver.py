"""A thread for each ring that is waited for: it receives, and as owner of the state deals with what it received."""

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
from gateway.robot.host.disk_writer import report_mistake
from gateway.robot.host.ownership import Ownership
from gateway.robot.zenoh_io.questions import QuestionRing

OwnersTask = Callable[[], float | None]
"""Handles one item, with the state owned. Returns the seconds to wait before the next one, or None."""
Reader = Callable[[zenoh.Query, int, Reply], OwnersTask]
"""Reads one question, which came at this time (ns), on a thread that owns nothing."""
MOST_LOOKS: Final = 30
"""Beats of the loop, 3 s. At each the loop owns the state, and so a thread that only waits for it has had its turn."""


class ReceiverThread:
    """A thread that waits for a ring's next item, notes it, owns the state to deal with it, and waits for the next."""

    def __init__(
        self,
        name: str,
        ring: Handler[Any] | QuestionRing,
        loop: asyncio.AbstractEventLoop,
        owner: Ownership,
        note: Callable[[Any, int], OwnersTask],
        *,
        priority: int = RECEIVER_PRIORITY,
    ):
        """`note` is called before the thread owns the state, and returns what is to be done then."""
        self._ring = ring
        self._loop = loop
        self._owner = owner
        self._note = note
        self._priority = priority
        self._in_hand_ns: int | None = None
        """When the item came that is being dealt with."""
        self._seen_ns: int | None = None
        self._looks = 0
        self.thread = threading.Thread(target=self._wait, name=name, daemon=True)
        self.thread.start()

    def makes_progress(self) -> bool:
        """Return whether the thread is alive and makes progress. Call it once a beat."""
        self._looks = self._looks + 1 if self._in_hand_ns is not None and self._in_hand_ns == self._seen_ns else 0
        self._seen_ns = self._in_hand_ns
        return self.thread.is_alive() and self._looks < MOST_LOOKS

    def _wait(self) -> None:
        prefer_thread(self._priority)
        with suppress(zenoh.ZError):  # the ring closes with the session, which ends the thread
            while True:
                item = self._ring.recv()
                now_ns = self._in_hand_ns = time.monotonic_ns()
                pause_s = None
                try:
                    deal = self._note(item, now_ns)
                    del item  # a query that is still referenced keeps its asker waiting
                    with self._owner:
                        pause_s = deal()
                    del deal
                except Exception as error:
                    report_mistake(self._loop, f"the thread {self.thread.name} failed", error)
                self._in_hand_ns = None
                if pause_s is not None:
                    time.sleep(pause_s)
