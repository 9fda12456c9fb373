"""Waiting for what nothing reports."""

import time
from collections.abc import Callable


def wait_until(holds: Callable[[], bool], what: str = "it holds", within_s: float = 30.0) -> None:
    """Look until it holds. Raises TimeoutError."""
    give_up_s = time.monotonic() + within_s
    while not holds():
        if time.monotonic() > give_up_s:
            raise TimeoutError(f"not within {within_s:g} s: {what}")
        time.sleep(0.01)
