"""What one page may have under way: its tasks, and the messages that wait for it. Both are bounded.

So a page that is frozen, or has a bad link, costs a bounded amount of memory and delays no other page. asyncio itself
refers to tasks only weakly, so each is kept here until it ends.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from contextlib import nullcontext
from typing import Any, Final

from gateway.people.console.pages import page_messages as messages
from schemas.telemetry import Report


class EndError(Exception):
    """Ends a page's WebSocket; the text is the reason that the page receives."""


class PageTasks:
    """A bound on what one page may have under way. On the event loop."""

    def __init__(self, most: int, what: str, *, in_turn: bool = False) -> None:
        """`what` the page waits for, in words. `in_turn`: one task runs at a time, in the order of their starts."""
        self._most = most
        self._what = what
        self._turn = asyncio.Lock() if in_turn else nullcontext()
        self._tasks: set[asyncio.Task[None]] = set()

    def check(self) -> None:
        """Raise EndError if no further task may be started: none of our pages asks for more at once."""
        if len(self._tasks) >= self._most:
            raise EndError(f"{self._most} {self._what} of this page wait for their answers")

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Run it, also beyond the bound: what a page's end requires is never rejected."""
        task = asyncio.get_running_loop().create_task(self._run(work))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _run(self, work: Coroutine[Any, Any, None]) -> None:
        async with self._turn:
            await work


KEPT_MESSAGES: Final = 64
"""The most messages kept of each kind: beyond it the oldest are dropped."""


class Outgoing:
    """Filled by `put`, emptied by `wait`. On the event loop."""

    def __init__(self) -> None:
        self._there = asyncio.Event()
        self._stops: dict[int, messages.Stopping] = {}
        self._answers: deque[Report] = deque(maxlen=KEPT_MESSAGES)
        self._newest: dict[type[Report] | None, Callable[[], str]] = {}
        self._events: deque[messages.EventMessage] = deque()

    def put(self, message: Report) -> None:
        """Queue a message to the page. Never waits."""
        match message:
            case messages.Stopping():
                self._stops[message.id] = message
                if len(self._stops) > KEPT_MESSAGES:
                    del self._stops[next(iter(self._stops))]
            case messages.LinkMessage() | messages.WalkMessage() | messages.BodyMessage() | messages.TelemetryMessage():
                self._newest[type(message)] = message.model_dump_json
            case messages.EventMessage():
                self._events.append(message)
                if len(self._events) > KEPT_MESSAGES:
                    left_out = self._events.popleft().left_out + 1 + self._events[0].left_out
                    self._events[0] = self._events[0].model_copy(update={"left_out": left_out})
            case _:
                self._answers.append(message)
        self._there.set()

    def put_state(self, text: Callable[[], str]) -> None:
        """Queue a state; `text` makes the message when it is sent, with the state's age at that time."""
        self._newest[None] = text
        self._there.set()

    async def wait(self) -> list[str]:
        """The texts to send now, in this order; waits until there is one."""
        await self._there.wait()
        self._there.clear()
        texts = [message.model_dump_json() for message in (*self._stops.values(), *self._answers)]
        texts += [newest() for newest in self._newest.values()]
        texts += [event.model_dump_json() for event in self._events]
        for sent in (self._stops, self._answers, self._newest, self._events):
            sent.clear()
        return texts
