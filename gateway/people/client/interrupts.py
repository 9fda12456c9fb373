"""Ctrl-C and SIGTERM while an `AsyncWalk` is open: the first makes the robot sit down, the second stops it at once.

Python delivers signals to the main thread only. A handler that the program installed is still called.
"""

import asyncio
import signal
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import FrameType
from typing import Any, ClassVar, Final, Self

from gateway.people.client.walk import Terminated

_TWICE: Final = 2


class Interrupts:
    """Counts signals while walks of the main thread's loop are open.

    `asyncio.run` cancels its main task at the first Ctrl-C. For SIGTERM, and for Ctrl-C without that handler, this
    cancels the task that opened it, at most twice. The third signal ends the program.
    """

    _open: ClassVar[list["Interrupts"]] = []
    _before: ClassVar[dict[int, Any]] = {}
    """The handler of each signal before the first walk opened."""

    def __init__(self) -> None:
        self.count = 0
        self._ours: int | None = None
        self._task: asyncio.Task[Any] | None = None

    def open(self) -> Self:
        """Begin. Call it in the task that uses the walk."""
        if threading.current_thread() is not threading.main_thread():
            return self
        self._task = asyncio.current_task()
        if not self._open:
            for number in (signal.SIGINT, signal.SIGTERM):
                before = signal.getsignal(number)
                if callable(before) if number == signal.SIGINT else before == signal.SIG_DFL:
                    self._before[number] = before
                    signal.signal(number, self._received)
        self._open.append(self)
        return self

    def close(self) -> None:
        """End. Raises KeyboardInterrupt or Terminated if a signal has cancelled the task."""
        if self in self._open:
            self._open.remove(self)
            if not self._open:
                for number in list(self._before):
                    self._restore(number)
        if self._ours is not None:
            raise KeyboardInterrupt if self._ours == signal.SIGINT else Terminated

    def meant(self, error: BaseException | None) -> BaseException | None:
        """Return the error that a blocking walk would get instead of the task's `error`."""
        if isinstance(error, asyncio.CancelledError) and self.count == 1:
            return KeyboardInterrupt()  # at which a walk sits
        if isinstance(error, KeyboardInterrupt) and self.count > 1:
            return asyncio.CancelledError()  # the second signal came before this
        return error

    @asynccontextmanager
    async def closing(self, end_now: Callable[[], None]) -> AsyncIterator[None]:
        """While a walk is closed, another signal or cancellation calls `end_now`. Raises as `close`."""
        try:
            yield
        except (asyncio.CancelledError, KeyboardInterrupt):
            end_now()
            raise
        finally:
            self.close()

    @classmethod
    def _received(cls, number: int, frame: FrameType | None) -> None:
        before = cls._before[number]
        for each in cls._open:
            each.count += 1
        if before not in (signal.SIG_DFL, signal.default_int_handler):
            before(number, frame)
        elif all(each.count <= _TWICE for each in cls._open):
            for each in cls._open:
                each._cancel(number)
        else:
            cls._restore(number)
            signal.raise_signal(number)

    def _cancel(self, number: int) -> None:
        self._ours = number
        if self._task is not None:
            self._task.get_loop().call_soon_threadsafe(self._task.cancel)

    @classmethod
    def _restore(cls, number: int) -> None:
        before = cls._before.pop(number)
        if signal.getsignal(number) == cls._received:
            signal.signal(number, before)
