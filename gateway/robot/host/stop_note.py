"""When `stop-servos` wrote its Stops: a note for the black box of the gateway that starts next.

It is in the service's runtime directory, in memory: a reboot resets both the note and the monotonic clock of its times.
Only people use it, so every error is ignored.
"""

from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.host.directories import runtime_directory

_NAME: Final = "stop-servos"
_MOST_BYTES: Final = 50
"""The note has some 30."""


class StopNote(NamedTuple):
    """Times of the monotonic clock: after the first round of Stops, and after the last."""

    first_ns: int
    last_ns: int


def leave(note: StopNote) -> None:
    """Write the note, after the Stops; nothing without a runtime directory. Never raises."""
    path = _path()
    if path is not None:
        with suppress(OSError):
            path.write_text(" ".join(map(str, note)))


def take() -> StopNote | None:
    """Read and remove the note; None: there is none that can be read. Never raises."""
    path = _path()
    if path is None:
        return None
    with suppress(OSError, ValueError, TypeError):
        with path.open("rb") as file:
            found = StopNote(*map(int, file.read(_MOST_BYTES).split()))
        path.unlink()
        return found
    return None


def _path() -> Path | None:
    folder = runtime_directory()
    return None if folder is None else folder / _NAME
