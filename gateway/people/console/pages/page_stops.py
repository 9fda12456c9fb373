"""Stops that pages request: tasks and a timer around `ConfirmedStop`."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

from gateway.people.client.confirmed_stop import ConfirmedStop, Press, StopRequest
from gateway.people.client.dangers import confirmed_off
from gateway.people.console.pages.page_messages import Stopping
from gateway.people.console.pages.page_tasks import Outgoing
from schemas.telemetry import Ack

W = TypeVar("W")


class Stops(Generic[W]):
    """Stops of pages. A request that ends without an answer, for any reason, is repeated."""

    def __init__(
        self,
        ask: Callable[[W], Awaitable[Ack]],
        note: Callable[[Press[Outgoing, W], Ack | None, str | None], None],
        lasts_s: float | None = None,
    ) -> None:
        """`ask` requests the Stop with the newest press's `what`, and returns its Ack or raises.

        `note` is called with each press at once, and whenever a request for it has ended, with the Ack or the error.
        `lasts_s`: how long it is requested again; None: until it is confirmed.
        """
        self._ask = ask
        self._note = note
        self._stop = ConfirmedStop[Outgoing, W](None if lasts_s is None else round(lasts_s * 1e9))
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._next: asyncio.TimerHandle | None = None

    @property
    def unconfirmed(self) -> bool:
        """Whether a press waits for its confirmation."""
        return self._stop.since_ns is not None

    def press(self, page: Outgoing, press_id: int | None, what: W) -> None:
        press = self._stop.press(page, press_id, what, now_ns())
        self._begin()
        self._note(press, None, None)

    def leave(self, page: Outgoing) -> None:
        """Record that the page is gone. Its Stops are still requested."""
        self._stop.leave(page)

    def _begin(self) -> None:
        """Begin the requests that are due, and set the timer for the next."""
        if self._next is not None:
            self._next.cancel()
        while (request := self._stop.begin(now_ns())) is not None:
            task = self._loop.create_task(self._run(request))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        due_ns = self._stop.due_ns
        self._next = None if due_ns is None else self._loop.call_at(due_ns / 1e9, self._begin)

    async def _run(self, request: StopRequest[W]) -> None:
        ack, error = None, None
        try:
            ack = await self._ask(request.what)
        except Exception as failed:  # also for want of a thread, memory or a descriptor: it is requested again
            error = str(failed) or repr(failed)
        waited = self._stop.ended(request, now_ns(), answered=ack is not None)
        self._begin()
        for press in waited:
            self._note(press, ack, error)


def now_ns() -> int:
    """The running event loop's clock in ns, used for the times of presses."""
    return round(asyncio.get_running_loop().time() * 1e9)


def send_stopping(press: Press[Outgoing, str], ack: Ack | None, error: str | None) -> None:
    """Send the progress of STOP ALL to the page that pressed it."""
    if press.page is None:
        return
    press.page.put(
        Stopping(
            id=press.id or 0,
            asked_ms_ago=(now_ns() - press.pressed_ns) / 1e6,
            answered=ack is not None,
            attempts=press.attempts,
            stop_frames=None if ack is None else ack.stop_frames,
            latency_us=None if ack is None else ack.latency_us,
            estop=None if ack is None else ack.estop,
            power="" if ack is None else confirmed_off(ack),
            error=error,
        )
    )
