"""A Stop that is requested at once, and again until it is confirmed.

`ConfirmedStop` has the rules, without a clock, a thread or a link; `UntilConfirmed` has the threads for a terminal.

Each press begins a request at once, unless REQUESTS_AT_ONCE requests are in progress. Only the answer to a request that
began after the press confirms the press: an earlier Stop may have been reset in between. After any other result the
next request begins AGAIN_NS later. So for each unconfirmed press, a request that can confirm it is in progress or due.
A press remains when its page is gone.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from gateway.people.watching.dangers import Remark, StopStatus
from schemas.ack import Ack

P = TypeVar("P")
W = TypeVar("W")

REQUESTS_AT_ONCE: Final = 4
"""The most requests in progress; a key that is held down repeats about 30 times a second."""
AGAIN_NS: Final = 100_000_000
"""Pause after a request without an answer, for which the client has already waited."""
MAX_PRESSES: Final = 16
"""Unconfirmed presses of one page. A newer press replaces the oldest, since it requests the same."""


@dataclass(eq=False, slots=True)
class Press(Generic[P, W]):
    """One press on a page, until it is confirmed or given up."""

    page: P | None
    """None: the page that pressed is gone."""
    id: int | None
    """The page's own count; None: the page wants no answer."""
    what: W
    """The content of a request for this press."""
    pressed_ns: int
    number: int
    """The number among all pages' presses, in the order in which they came."""
    attempts: int = 0
    """Requests that could have confirmed it and have ended."""
    over: bool = False
    """It is confirmed, or its time is over."""


@dataclass(frozen=True, eq=False, slots=True)
class StopRequest(Generic[W]):
    """A request in progress. Its answer confirms every press up to number `covers`."""

    covers: int
    what: W


class ConfirmedStop(Generic[P, W]):
    """All pages' presses of one Stop. Its shell calls `begin` after each change, and again at `due_ns`."""

    def __init__(self, lasts_ns: int | None = None) -> None:  # mutants accepted (Forget, Step): set before it is read
        """`lasts_ns`: how long after a press requests begin for it; None: until it is confirmed."""
        self._lasts_ns = lasts_ns
        self._presses = 0
        self._asked = 0
        """The newest press that a request has covered."""
        self._again_ns = 0
        self._unconfirmed: list[Press[P, W]] = []
        self._under_way: list[StopRequest[W]] = []

    @property
    def since_ns(self) -> int | None:
        """When the oldest unconfirmed press arrived, or None."""
        return self._unconfirmed[0].pressed_ns if self._unconfirmed else None

    def press(self, page: P, press_id: int | None, what: W, now_ns: int) -> Press[P, W]:
        self._presses += 1
        press: Press[P, W] = Press(page, press_id, what, now_ns, self._presses)
        mine = [other for other in self._unconfirmed if other.page is page]
        if len(mine) >= MAX_PRESSES:
            self._unconfirmed.remove(mine[0])
        self._unconfirmed.append(press)
        return press

    def leave(self, page: P) -> None:
        """Record that a page is gone. Of all gone pages' presses only the newest is kept: its request covers all."""
        for press in self._unconfirmed:
            if press.page is page:
                press.page = None
        for press in [press for press in self._unconfirmed if press.page is None][:-1]:
            self._unconfirmed.remove(press)

    def take_back(self) -> None:
        """Drop all presses."""
        self._unconfirmed.clear()

    @property
    def due_ns(self) -> int | None:
        """When the next request begins, perhaps in the past, or None.

        Only the newest press matters: a request that can confirm it can confirm all.
        """
        if not self._unconfirmed or len(self._under_way) >= REQUESTS_AT_ONCE:
            return None
        newest = self._unconfirmed[-1]
        if any(request.covers >= newest.number for request in self._under_way):
            return None
        return newest.pressed_ns if newest.number > self._asked else self._again_ns

    def begin(self, now_ns: int) -> StopRequest[W] | None:
        """Return the request to begin now, or None."""
        due_ns = self.due_ns
        if due_ns is None or now_ns < due_ns:
            return None
        request = StopRequest(self._presses, self._unconfirmed[-1].what)
        self._asked = request.covers
        self._under_way.append(request)
        return request

    def ended(self, request: StopRequest[W], now_ns: int, *, answered: bool) -> list[Press[P, W]]:
        """Take a request's end. Return the presses that it covered, without those confirmed or dropped before."""
        self._under_way.remove(request)
        covered = [press for press in self._unconfirmed if press.number <= request.covers]
        if not answered:
            self._again_ns = now_ns + AGAIN_NS
        for press in covered:
            press.attempts += 1
            is_too_late = self._lasts_ns is not None and self._again_ns - press.pressed_ns > self._lasts_ns
            press.over = answered or is_too_late
            if press.over:
                self._unconfirmed.remove(press)
        return covered


class UntilConfirmed:
    """A Stop key: requests the Stop on threads of its own, by the rules of `ConfirmedStop`.

    The threads exist from the beginning, so a press needs no new one. Every exception from a request counts as no
    answer.
    """

    def __init__(self, request: Callable[[], Ack], on_change: Callable[[], object]) -> None:
        """`on_change` is called after each change of `status`. It must neither wait nor raise."""
        self._request = request
        self._on_change = on_change
        self._stop = ConfirmedStop[object, None]()
        self.status = StopStatus()
        self._changed = threading.Condition(threading.Lock())
        """Its lock is held only briefly, so that a press does not wait."""
        for _ in range(REQUESTS_AT_ONCE):
            threading.Thread(target=self._serve, name="stop", daemon=True).start()

    def press(self) -> None:
        """Request the Stop now. Never waits."""
        with self.changes() as status:
            now_ns = time.monotonic_ns()
            self._stop.press(self, None, None, now_ns)
            status.press(now_ns)

    def take_back(self) -> None:
        """Drop all presses: the person who pressed has reset the robot."""
        with self.changes() as status:
            self._stop.take_back()
            status.reset()

    @contextmanager
    def changes(self) -> Iterator[StopStatus]:
        """Yield the status, for a change by one thread at a time."""
        with self._changed:
            yield self.status
            self._changed.notify()  # a request may be due
        self._on_change()

    def remark(self, now_ns: int) -> Remark | None:
        """See `StopStatus.remark`."""
        with self._changed:
            return self.status.remark(now_ns)

    def _serve(self) -> None:
        while True:
            request = self._next()
            ack: Ack | None = None
            with suppress(Exception):
                ack = self._request()
            with self.changes() as status:
                now_ns = time.monotonic_ns()
                waited = self._stop.ended(request, now_ns, answered=ack is not None)
                if waited and ack is None:
                    status.unanswered()
                elif waited and ack is not None:
                    status.confirm(ack, self._stop.since_ns, now_ns)

    def _next(self) -> StopRequest[None]:
        with self._changed:
            while (request := self._stop.begin(time.monotonic_ns())) is None:
                due_ns = self._stop.due_ns
                self._changed.wait(None if due_ns is None else max(0.0, (due_ns - time.monotonic_ns()) / 1e9))
            return request
