"""A note of when `stop-servos` wrote its Stops, for the black box of the next gateway.

It is in the service's runtime directory, in memory: a reboot ends both the note and the monotonic clock of its times.
Only people use it, so every error is ignored.
"""

from contextlib import suppress
from typing import Final, NamedTuple

from gateway.host.directories import runtime_directory

_NAME: Final = "stop-servos"
_MOST_BYTES: Final = 50
"""The note has about 30."""


class StopNote(NamedTuple):
    """Times after the first and after the last round of Stops, in ns of the monotonic clock."""

    first_ns: int
    last_ns: int


def leave(note: StopNote) -> None:
    """Write the note, after the Stops. Without a runtime directory, do nothing. Never raises."""
    folder = runtime_directory()
    if folder is not None:
        with suppress(OSError):
            (folder / _NAME).write_text(" ".join(map(str, note)))


def take() -> StopNote | None:
    """Remove and return the note, or None if there is no readable one. Never raises."""
    folder = runtime_directory()
    if folder is None:
        return None
    path = folder / _NAME
    with suppress(OSError, ValueError, TypeError):
        with path.open("rb") as file:
            found = StopNote(*map(int, file.read(_MOST_BYTES).split()))
        path.unlink()
        return found
    return None
