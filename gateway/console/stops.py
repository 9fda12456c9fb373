"""STOP ALL: asked at once and ahead of everything, and again until the gateway confirms it.

What counts for a press is an answer to a request that began after it: an earlier one may have been reset in between.
A press outlives its page. Only the gateway's answer ends it.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final, Protocol

from gateway.console.messages import Stopping
from gateway.errors import GatewayError
from schemas.telemetry import Ack

AT_ONCE: Final = 4
"""Requests under way at most; a key that is held down repeats some 30 times a second."""
AGAIN_S: Final = 0.1
MAX_PRESSES: Final = 64
"""Of one page, unconfirmed; more of them are the same wish."""


class Teller(Protocol):
    """The page that pressed; it may be gone."""

    def tell(self, message: Stopping) -> None:
        """How far its stop has come. Never waits."""


@dataclass(eq=False)
class _Press:
    page: Teller
    id: int
    pressed_ns: int
    attempts: int = 0


class Stops:
    """All pages' stops."""

    def __init__(self, ask: Callable[[], Awaitable[Ack]]) -> None:
        """`ask` requests the emergency stop and waits for its Ack, or raises GatewayError."""
        self._ask = ask
        self._unconfirmed: list[_Press] = []
        self._requests: set[asyncio.Task[None]] = set()
        self._newest_began_ns = 0

    @property
    def unconfirmed(self) -> bool:
        """Whether a press waits for its confirmation."""
        return bool(self._unconfirmed)

    def press(self, page: Teller, press_id: int) -> None:
        """A page asks for it, now."""
        press = _Press(page, press_id, time.monotonic_ns())
        if sum(other.page is page for other in self._unconfirmed) < MAX_PRESSES:
            self._unconfirmed.append(press)
        if len(self._requests) < AT_ONCE:
            self._request()
        self._tell(press)

    def _request(self) -> None:
        request = asyncio.get_running_loop().create_task(self._run())
        self._requests.add(request)
        request.add_done_callback(self._requests.discard)

    async def _run(self) -> None:
        began_ns = self._newest_began_ns = time.monotonic_ns()
        try:
            ack, error = await self._ask(), None
        except GatewayError as failed:
            ack, error = None, str(failed)
        for press in [press for press in self._unconfirmed if press.pressed_ns <= began_ns]:
            press.attempts += 1
            if ack is not None:
                self._unconfirmed.remove(press)
            self._tell(press, ack, error)
        if ack is None:
            await asyncio.sleep(AGAIN_S)
        waiting = any(press.pressed_ns > self._newest_began_ns for press in self._unconfirmed)
        if waiting or (self._unconfirmed and len(self._requests) == 1):  # this one, which ends now
            self._request()

    def _tell(self, press: _Press, ack: Ack | None = None, error: str | None = None) -> None:
        press.page.tell(
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
