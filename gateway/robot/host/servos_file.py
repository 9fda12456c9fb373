"""A file that shows whether a servo runs, for an upgrade and `setup`, which have no certificate to ask over Zenoh.

It has one line, `MONOTONIC_NS 0` or `MONOTONIC_NS 1`, written ten times a second into the service's runtime directory.
The file is memory-mapped, so a write needs no system call. A line older than a second means that the service hangs.
It is separate from `stop_note`, since `stop-servos` loads neither logging nor mmap.
"""

import logging
import mmap
import os
from pathlib import Path
from typing import Final

SERVOS_FILE: Final = "servos"
_LINE: Final = "%020d %d\n"
_BYTES: Final = len(_LINE % (0, 0))

logger = logging.getLogger(__name__)


class ServosFile:
    """The file in `folder`, the service's runtime directory. None: no file is written."""

    def __init__(self, folder: Path | None) -> None:
        self._map: mmap.mmap | None = None
        if folder is None:
            return
        try:
            descriptor = os.open(folder / SERVOS_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            with os.fdopen(descriptor, "r+b") as file:
                file.truncate(_BYTES)
                self._map = mmap.mmap(descriptor, _BYTES)
        except OSError as error:
            logger.warning("an upgrade cannot see whether a servo runs: %s", error)

    def write(self, now_ns: int, *, any_runs: bool) -> None:
        """Record whether any servo runs, at `now_ns` of the monotonic clock."""
        if self._map is not None:
            self._map[:] = (_LINE % (now_ns, any_runs)).encode()
