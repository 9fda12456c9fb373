"""STOP ALL: asked at once and ahead of everything, and again until the gateway confirms it.

What counts for a press is an answer to a request that began after it: an earlier one may have been reset in between.
A press outlives its page. Only the gateway's answer ends it: whatever else comes of a request, also a fault in this
program or a machine without memory, counts as no answer, and the next request follows.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final

from gateway.people.client.stops import AGAIN_S, AT_ONCE
from gateway.people.console.messages import Stopping
from gateway.people.console.outgoing import Outgoing
from schemas.telemetry import Ack

MAX_PRESSES: Final = 16
"""Of one page, unconfirmed; the newest makes the oldest give way, for it asks for the same, later."""


@dataclass(eq=False)
class _Press:
    page: Outgoing | None
    """Of the page that pressed; None: it is gone."""
    id: int
    source: str | None
    pressed_ns: int
    attempts: int = 0


class Stops:
    """All pages' stops."""

    def __init__(self, ask: Callable[[str | None], Awaitable[Ack]]) -> None:
        """`ask` requests the emergency stop by a name (None: the console's) and waits for its Ack, or raises."""
        self._ask = ask
        self._unconfirmed: list[_Press] = []
        self._requests: set[asyncio.Task[None] | None] = set()
        self._newest_began_ns = 0

    @property
    def unconfirmed(self) -> bool:
        """Whether a press waits for its confirmation."""
        return bool(self._unconfirmed)

    def press(self, page: Outgoing, press_id: int, source: str | None = None) -> None:
        """A page asks for it, now; `source` is by whose name, if not the console's."""
        press = _Press(page, press_id, source, time.monotonic_ns())
        mine = [other for other in self._unconfirmed if other.page is page]
        if len(mine) >= MAX_PRESSES:
            self._unconfirmed.remove(mine[0])
        self._unconfirmed.append(press)
        if len(self._requests) < AT_ONCE:
            self._request(source)
        self._send(press)

    def leave(self, page: Outgoing) -> None:
        """The page is gone: of its presses, and those of all that went before, the newest stands for all of them."""
        for press in self._unconfirmed:
            if press.page is page:
                press.page = None
        orphans = [press for press in self._unconfirmed if press.page is None]
        for press in orphans[:-1]:
            self._unconfirmed.remove(press)

    def _request(self, source: str | None) -> None:
        request = asyncio.get_running_loop().create_task(self._run(source))
        self._requests.add(request)
        request.add_done_callback(self._requests.discard)

    async def _run(self, source: str | None) -> None:
        began_ns = self._newest_began_ns = time.monotonic_ns()
        ack, error = None, None
        try:
            ack = await self._ask(source)
        except Exception as failed:  # no thread, no memory, no descriptor: whatever it is, it is asked again
            error = str(failed) or repr(failed)
        for press in [press for press in self._unconfirmed if press.pressed_ns <= began_ns]:
            press.attempts += 1
            if ack is not None:
                self._unconfirmed.remove(press)
            self._send(press, ack, error)
        if ack is None:
            await asyncio.sleep(AGAIN_S)
        self._requests.discard(asyncio.current_task())  # two that end at once must not each leave it to the other
        waiting = any(press.pressed_ns > self._newest_began_ns for press in self._unconfirmed)
        if waiting or (self._unconfirmed and not self._requests):
            self._request(self._unconfirmed[-1].source)

    def _send(self, press: _Press, ack: Ack | None = None, error: str | None = None) -> None:
        if press.page is None:
            return
        press.page.put(
            Stopping(
                id=press.id,
                asked_ms_ago=(time.monotonic_ns() - press.pressed_ns) / 1e6,
                answered=ack is not None,
                attempts=press.attempts,
                stop_frames=None if ack is None else ack.stop_frames,
                latency_us=None if ack is None else ack.latency_us,
                estop=None if ack is None else ack.estop,
                error=error,
            )
        )
