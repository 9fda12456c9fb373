"""What is noted in the service's runtime directory, in memory.

- When `stop-servos` wrote its Stops, for the black box of the gateway that starts next. A reboot resets both the note
  and the monotonic clock of its times. Only people use it, so every error is ignored.
- Whether a servo runs, for an upgrade and `setup`, which have no certificate to ask over the network: one line,
  `MONOTONIC_NS 0` or `MONOTONIC_NS 1`, written ten times a second. The file is memory-mapped, so a write needs no
  system call. A line older than a second means that the service hangs.
"""

import logging
import mmap
import os
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


SERVOS_FILE: Final = "servos"
_LINE: Final = "%020d %d\n"
_BYTES: Final = len(_LINE % (0, 0))

logger = logging.getLogger(__name__)


class ServosFile:
    """The file in `folder`, the service's runtime directory; None: no file is written."""

    def __init__(self, folder: Path | None) -> None:
        self._map: mmap.mmap | None = None
        if folder is None:
            return
        try:
            descriptor = os.open(folder / SERVOS_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            try:
                os.ftruncate(descriptor, _BYTES)
                self._map = mmap.mmap(descriptor, _BYTES)
            finally:
                os.close(descriptor)
        except OSError as error:
            logger.warning("an upgrade cannot see whether a servo runs: %s", error)

    def write(self, now_ns: int, *, any_runs: bool) -> None:
        """Record whether any servo runs, at `now_ns` of the monotonic clock."""
        if self._map is not None:
            self._map[:] = (_LINE % (now_ns, any_runs)).encode()
