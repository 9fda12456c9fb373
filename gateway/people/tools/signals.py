"""How a command that runs for long is asked to end."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def on_end_signals(end: Callable[[], object]) -> Iterator[None]:
    """Call `end`, which must wait for nothing, on Ctrl-C, SIGTERM and the end of the terminal."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        end()

    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
