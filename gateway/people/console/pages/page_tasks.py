"""What one page may have under way: its tasks, its Stops, and the messages that wait for it. All are bounded.

So a page that is frozen, or has a bad link, costs a bounded amount of memory and delays no other page. asyncio itself
refers to tasks only weakly, so each is kept here until it ends.
"""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import nullcontext
from functools import partial
from typing import Any, Final, Generic, TypeVar

from gateway.people.console.pages.page_messages import Message, json_of
from gateway.people.watching.confirmed_stop import REQUESTS_AT_ONCE, ConfirmedStop, Press, StopRequest
from gateway.people.watching.dangers import confirmed_off
from schemas.ack import Ack


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

    async def ended(self, timeout_s: float) -> None:
        """Wait until those of now have ended, for `timeout_s` at most."""
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=timeout_s)

    async def _run(self, work: Coroutine[Any, Any, None]) -> None:
        async with self._turn:
            await work


KEPT_MESSAGES: Final = 64
"""The most messages kept of each kind: beyond it the oldest are dropped."""


class Outgoing:
    """Filled by `put`, emptied by `wait`. On the event loop."""

    def __init__(self) -> None:
        self._there = asyncio.Event()
        self._stops: dict[int, Message] = {}
        self._answers: deque[Message] = deque(maxlen=KEPT_MESSAGES)
        self._newest: dict[str, Callable[[], str]] = {}
        self._events: deque[Message] = deque()

    def put(self, message: Message) -> None:
        """Queue a message to the page. Never waits."""
        match message["type"]:
            case "stop":
                self._stops[message["id"]] = message
                if len(self._stops) > KEPT_MESSAGES:
                    del self._stops[next(iter(self._stops))]
            case "link" | "walk" | "body" | "telemetry" as kind:
                self._newest[kind] = partial(json_of, message)
            case "event":
                self._events.append(message)
                if len(self._events) > KEPT_MESSAGES:
                    left_out = self._events.popleft()["left_out"] + 1 + self._events[0]["left_out"]
                    self._events[0] = {**self._events[0], "left_out": left_out}
            case _:
                self._answers.append(message)
        self._there.set()

    def put_state(self, text: Callable[[], str]) -> None:
        """Queue a state; `text` makes the message when it is sent, with the state's age at that time."""
        self._newest["state"] = text
        self._there.set()

    async def wait(self) -> list[str]:
        """The texts to send now, in this order; waits until there is one."""
        await self._there.wait()
        self._there.clear()
        texts = [json_of(message) for message in (*self._stops.values(), *self._answers)]
        texts += [newest() for newest in self._newest.values()]
        texts += map(json_of, self._events)
        for sent in (self._stops, self._answers, self._newest, self._events):
            sent.clear()
        return texts


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
        self._tasks = PageTasks(REQUESTS_AT_ONCE, "requests")
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
            self._tasks.start(self._run(request))
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
        {
            "type": "stop",
            "id": press.id or 0,
            "asked_ms_ago": (now_ns() - press.pressed_ns) / 1e6,
            "answered": ack is not None,
            "attempts": press.attempts,
            **({} if ack is None else ack.model_dump(include={"stop_frames", "latency_us", "estop"})),
            "power": "" if ack is None else confirmed_off(ack),
            "error": error,
        }
    )
