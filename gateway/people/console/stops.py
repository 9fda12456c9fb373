"""Stops that pages press: tasks around `ConfirmedStop`."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

from gateway.people.client.confirmed_stop import ConfirmedStop, Press, StopRequest
from gateway.people.console.messages import Stopping
from gateway.people.console.outgoing import Outgoing
from schemas.telemetry import Ack

W = TypeVar("W")


class Stops(Generic[W]):
    """Whatever comes of a request besides an answer, also a fault in this program or no memory, counts as none."""

    def __init__(
        self,
        ask: Callable[[W], Awaitable[Ack]],
        note: Callable[[Press[Outgoing, W], Ack | None, str | None], None],
        lasts_s: float | None = None,
    ) -> None:
        """`ask` requests it with what the newest press gave, and waits for its Ack, or raises.

        `note` is given each press at once, and whenever a request for it has ended: with the answer, or why there is
        none. `lasts_s`: for so long it is requested again; None: until it is confirmed.
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
        """A page asks for it, now."""
        press = self._stop.press(page, press_id, what, now_ns())
        self._begin()
        self._note(press, None, None)

    def leave(self, page: Outgoing) -> None:
        """The page is gone; what it pressed is still wanted."""
        self._stop.leave(page)

    def _begin(self) -> None:
        """Begin what is due, and look again when the next is."""
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
        except Exception as failed:  # no thread, no memory, no descriptor: whatever it is, it is asked again
            error = str(failed) or repr(failed)
        waited = self._stop.ended(request, now_ns(), answered=ack is not None)
        self._begin()
        for press in waited:
            self._note(press, ack, error)


def now_ns() -> int:
    """By the running event loop's clock, as a press has it."""
    return round(asyncio.get_running_loop().time() * 1e9)


def send_stopping(press: Press[Outgoing, str | None], ack: Ack | None, error: str | None) -> None:
    """Send the page that pressed STOP ALL how far it is."""
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
            error=error,
        )
    )
