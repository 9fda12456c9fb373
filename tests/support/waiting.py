"""Waiting for what nothing reports; what a thread repeats while a test goes on; what a `with` closes."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Self


def wait_until(holds: Callable[[], bool], what: str = "it holds", within_s: float = 30.0) -> None:
    """Poll until it holds. Raises TimeoutError."""
    give_up_s = time.monotonic() + within_s
    while not holds():
        if time.monotonic() > give_up_s:
            raise TimeoutError(f"not within {within_s:g} s: {what}")
        time.sleep(0.01)


@contextmanager
def meanwhile(act: Callable[[], object], every_s: float = 0.0) -> Iterator[None]:
    """Call `act` at this period, on a thread of its own, until the end of the `with`."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(every_s):
            act()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Closing(ABC):
    """Closes itself at the end of a `with`, however that ends."""

    @abstractmethod
    def close(self) -> object:
        """Release what it holds."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
