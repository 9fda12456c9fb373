"""A Stop that is requested at once, without waiting for anything, and again until the gateway confirms it."""

import threading
import time
from collections.abc import Callable
from typing import Final

from schemas.telemetry import Ack

AT_ONCE: Final = 4
"""Requests under way at most; a key that is held down repeats some 30 times a second."""
AGAIN_S: Final = 0.1
"""After a request that nobody answered, which itself has lasted as long as a client waits for an answer."""


class UntilConfirmed:
    """Each press begins a request on a thread of its own; the last of them goes on until the Stop is confirmed.

    The threads exist from the beginning: a press finds one also where the system allows no more. Only the gateway's
    answer ends it: whatever else comes of a request, also a fault in this program, counts as none.
    """

    def __init__(self, request: Callable[[], Ack], note: Callable[[Ack | None, int], bool]) -> None:
        """`note` is given the answer, None for none, and when its request began; returns whether it is still wanted."""
        self._request = request
        self._note = note
        self._lock = threading.Lock()
        self._under_way = 0
        self._pressed = threading.Semaphore(0)
        for _ in range(AT_ONCE):
            threading.Thread(target=self._serve, name="stop", daemon=True).start()

    def press(self) -> None:
        """Request it now. Never waits."""
        with self._lock:
            if self._under_way >= AT_ONCE:
                return
            self._under_way += 1
        self._pressed.release()

    def _serve(self) -> None:
        while True:
            self._pressed.acquire()
            self._run()

    def _run(self) -> None:
        while True:
            began_ns = time.monotonic_ns()
            try:
                ack = self._request()
            except Exception:
                ack = None
            wanted = self._note(ack, began_ns)
            with self._lock:
                if not wanted or self._under_way > 1:
                    self._under_way -= 1
                    return
            time.sleep(AGAIN_S)
