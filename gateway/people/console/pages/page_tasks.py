"""The tasks of one page: a bounded number, each kept until it ends (asyncio itself refers to them only weakly)."""

import asyncio
from collections.abc import Coroutine
from contextlib import nullcontext
from typing import Any


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
