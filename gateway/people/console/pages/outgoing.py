"""The messages that wait for one page: the newest state, and a bounded number of everything else.

So a page that is frozen, or has a bad link, costs a bounded amount of memory and delays no other page.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Final

from gateway.people.console.pages.page_messages import (
    BodyMessage,
    EventMessage,
    LinkMessage,
    Stopping,
    TelemetryMessage,
    WalkMessage,
)
from schemas.telemetry import Report

KEPT_MESSAGES: Final = 64
"""Of each kind; beyond it the oldest are dropped."""


class Outgoing:
    """Filled by `put`, emptied by `wait`. On the event loop."""

    def __init__(self) -> None:
        self._there = asyncio.Event()
        self._stops: dict[int, Stopping] = {}
        self._answers: deque[Report] = deque(maxlen=KEPT_MESSAGES)
        self._newest: dict[type[Report], Report] = {}
        self._state: Callable[[], str] | None = None
        self._events: deque[EventMessage] = deque(maxlen=KEPT_MESSAGES)
        self._events_lost = 0

    def put(self, message: Report) -> None:
        """Queue a message to the page. Never waits."""
        match message:
            case Stopping():
                self._stops[message.id] = message
                if len(self._stops) > KEPT_MESSAGES:
                    del self._stops[next(iter(self._stops))]
            case LinkMessage() | WalkMessage() | BodyMessage() | TelemetryMessage():
                self._newest[type(message)] = message
            case EventMessage():
                if len(self._events) == KEPT_MESSAGES:
                    self._events_lost += 1 + self._events[0].left_out
                self._events.append(message)
            case _:
                self._answers.append(message)
        self._there.set()

    def put_state(self, text: Callable[[], str]) -> None:
        """Queue a state; `text` makes the message when it is sent, with the state's age at that time."""
        self._state = text
        self._there.set()

    async def wait(self) -> list[str]:
        """The texts to send now, in this order; waits until there is one."""
        await self._there.wait()
        self._there.clear()
        messages: list[Report] = [*self._stops.values(), *self._answers, *self._newest.values()]
        texts = [message.model_dump_json() for message in messages]
        if self._state is not None:
            texts.append(self._state())
        if self._events_lost:
            left_out = self._events[0].left_out + self._events_lost
            self._events[0] = self._events[0].model_copy(update={"left_out": left_out})
            self._events_lost = 0
        texts += [event.model_dump_json() for event in self._events]
        for sent in (self._stops, self._answers, self._newest, self._events):
            sent.clear()
        self._state = None
        return texts
