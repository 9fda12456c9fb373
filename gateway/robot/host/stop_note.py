"""When `stop-servos` wrote its Stops: a note that it leaves for the black box of the gateway that starts next.

It lies in the service's runtime directory, in memory: a reboot ends both the note and the clock that its times are of.
Only people read it, so whatever is wrong with it is no reason for anything.
"""

from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.host.directories import runtime_directory

_NAME: Final = "stop-servos"
_MOST_BYTES: Final = 50
"""It has some 30."""


class StopNote(NamedTuple):
    """Times of the monotonic clock: after the first round of Stops, and after the last."""

    first_ns: int
    last_ns: int


def leave(note: StopNote) -> None:
    """Leave it; without a runtime directory nothing is left. Called once the Stops are written. Never raises."""
    path = _path()
    if path is not None:
        with suppress(OSError):
            path.write_text(" ".join(map(str, note)))


def take() -> StopNote | None:
    """The note that was left, and remove it; None: there is none, or none that can be read. Never raises."""
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
