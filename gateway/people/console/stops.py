"""STOP ALL of all pages: tasks around `ConfirmedStop`."""

import asyncio
from collections.abc import Awaitable, Callable

from gateway.people.client.confirmed_stop import ConfirmedStop, Press, Request
from gateway.people.console.messages import Stopping
from gateway.people.console.outgoing import Outgoing
from schemas.telemetry import Ack

_Press = Press[Outgoing, str | None]


class Stops:
    """Whatever comes of a request besides an answer, also a fault in this program or no memory, counts as none."""

    def __init__(self, ask: Callable[[str | None], Awaitable[Ack]]) -> None:
        """`ask` requests the emergency stop by a name (None: the console's) and waits for its Ack, or raises."""
        self._ask = ask
        self._stop = ConfirmedStop[Outgoing, str | None]()
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._next: asyncio.TimerHandle | None = None

    @property
    def unconfirmed(self) -> bool:
        """Whether a press waits for its confirmation."""
        return self._stop.since_ns is not None

    def press(self, page: Outgoing, press_id: int, source: str | None = None) -> None:
        """A page asks for it, now; `source` is by whose name, if not the console's."""
        press = self._stop.press(page, press_id, source, self._now_ns())
        self._begin()
        self._send(press)

    def leave(self, page: Outgoing) -> None:
        """The page is gone; what it pressed is still wanted."""
        self._stop.leave(page)

    def _begin(self) -> None:
        """Begin what is due, and look again when the next is."""
        if self._next is not None:
            self._next.cancel()
        while (request := self._stop.begin(self._now_ns())) is not None:
            task = self._loop.create_task(self._run(request))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        due_ns = self._stop.due_ns
        self._next = None if due_ns is None else self._loop.call_at(due_ns / 1e9, self._begin)

    async def _run(self, request: Request[str | None]) -> None:
        ack, error = None, None
        try:
            ack = await self._ask(request.what)
        except Exception as failed:  # no thread, no memory, no descriptor: whatever it is, it is asked again
            error = str(failed) or repr(failed)
        waited = self._stop.ended(request, self._now_ns(), answered=ack is not None)
        self._begin()
        for press in waited:
            self._send(press, ack, error)

    def _now_ns(self) -> int:
        return round(self._loop.time() * 1e9)

    def _send(self, press: _Press, ack: Ack | None = None, error: str | None = None) -> None:
        if press.page is None:
            return
        press.page.put(
            Stopping(
                id=press.id,
                asked_ms_ago=(self._now_ns() - press.pressed_ns) / 1e6,
                answered=ack is not None,
                attempts=press.attempts,
                stop_frames=None if ack is None else ack.stop_frames,
                latency_us=None if ack is None else ack.latency_us,
                estop=None if ack is None else ack.estop,
                error=error,
            )
        )
