"""A terminal's Stop: threads around `ConfirmedStop`."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from gateway.people.client.confirmed_stop import REQUESTS_AT_ONCE, ConfirmedStop, StopRequest
from schemas.telemetry import Ack


class UntilConfirmed:
    """Requests a Stop on threads of its own, by the rules of `ConfirmedStop`.

    The threads exist from the beginning: a press finds one even if the system allows no more. An exception from a
    request, also a fault in this program, counts as no answer.
    """

    def __init__(
        self, request: Callable[[], Ack], note: Callable[[Ack | Exception], bool], lasts_s: float | None = None
    ) -> None:
        """`note` receives each request's answer or error, in order; it must not wait, and returns whether to continue.

        `lasts_s`: how long after a press it is requested again; None: until it is confirmed.
        """
        self._request = request
        self._note = note
        self._stop = ConfirmedStop[object, None](None if lasts_s is None else round(lasts_s * 1e9))
        self._changed = threading.Condition(threading.Lock())
        """Its lock is held for moments only, so that a press never waits."""
        self._noting = threading.Lock()
        for _ in range(REQUESTS_AT_ONCE):
            threading.Thread(target=self._serve, name="stop", daemon=True).start()

    def press(self) -> None:
        """Request it now. Never waits."""
        with self._changed:
            self._stop.press(self, None, None, time.monotonic_ns())
            self._changed.notify()

    def take_back(self) -> None:
        """Drop all presses: the person who pressed has reset the robot."""
        with self._changed:
            self._stop.take_back()

    @property
    def since_ns(self) -> int | None:
        """When the oldest unconfirmed press came (monotonic ns); None: all are confirmed."""
        with self._changed:
            return self._stop.since_ns

    def _serve(self) -> None:
        while True:
            request = self._next()
            outcome: Ack | Exception
            try:
                outcome = self._request()
            except Exception as error:
                outcome = error
            with self._noting:  # otherwise an earlier failure could be noted after the answer
                self._end(request, outcome)

    def _next(self) -> StopRequest[None]:
        with self._changed:
            while (request := self._stop.begin(time.monotonic_ns())) is None:
                due_ns = self._stop.due_ns
                self._changed.wait(None if due_ns is None else max(0.0, (due_ns - time.monotonic_ns()) / 1e9))
            return request

    def _end(self, request: StopRequest[None], outcome: Ack | Exception) -> None:
        with self._changed:
            waited = self._stop.ended(request, time.monotonic_ns(), answered=isinstance(outcome, Ack))
            self._changed.notify()  # the next may be due
        wanted = True
        with suppress(Exception):  # an exception would end this thread, and the next press needs it
            wanted = not waited or self._note(outcome)
        if not wanted:
            with self._changed:
                self._stop.take_back(request)
