"""A note of when `stop-servos` wrote its Stops, for the black box of the next gateway.

It is in the service's runtime directory, in memory: a reboot ends both the note and the monotonic clock of its times.
Only people use it, so every error is ignored.
"""

from contextlib import suppress
from typing import Final

from gateway.host.directories import runtime_directory

_NAME: Final = "stop-servos"


def leave(first_ns: int, last_ns: int) -> None:
    """Note the times after the first and the last round of Stops, in ns of the monotonic clock. Never raises."""
    folder = runtime_directory()
    if folder is not None:
        with suppress(OSError):
            (folder / _NAME).write_text(f"{first_ns} {last_ns}")


def take() -> tuple[int, ...]:
    """Remove the note and return its times; empty if there is no readable one. Never raises."""
    folder = runtime_directory()
    with suppress(OSError, ValueError):
        if folder is not None:
            found = tuple(map(int, (folder / _NAME).read_text().split()))
            (folder / _NAME).unlink()
            return found
    return ()
