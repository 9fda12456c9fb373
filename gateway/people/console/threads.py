"""Threads that exist from the beginning: what has to be asked later must not fail because none can be started."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

T = TypeVar("T")

STACK_BYTES: Final = 1_048_576
"""Of each thread that Python starts; the system's 8 MB count as memory (`LimitDATA`), though nobody uses them."""
_START_S: Final = 10.0


class Threads:
    """So many, all of them started; what they are asked for beyond that waits for its turn."""

    def __init__(self, count: int, name: str) -> None:
        """Raises RuntimeError where the system does not allow so many."""
        self.executor = ThreadPoolExecutor(count, thread_name_prefix=name)
        together = threading.Barrier(count + 1)
        for _ in range(count):
            self.executor.submit(together.wait, _START_S)
        together.wait(_START_S)

    async def run(self, function: Callable[[], T]) -> T:
        """What it returns or raises. Cancelled, it goes on."""
        return await asyncio.get_running_loop().run_in_executor(self.executor, function)
