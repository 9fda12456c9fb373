"""The state directory, which one gateway writes: a second one's reset would remove the first one's emergency stop, and
its calibration would replace the first one's."""

import fcntl
import os
import threading
from pathlib import Path

from gateway.errors import ConfigError


class StateFolder:
    """One state directory. For any thread."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._ours: bool | None = None
        self._asking = threading.Lock()

    def own(self) -> None:
        """Lock the folder, at the first call, until this process ends. Waits for the disk.

        Raises ConfigError if another gateway had it then. It may have left an emergency stop, so its end changes
        nothing.
        """
        with self._asking:
            self._ours = self._lock() if self._ours is None else self._ours
        if not self._ours:
            why = "another gateway had this folder when this one started; give each a state.path of its own"
            raise ConfigError(f"{self.path}: {why}")

    def _lock(self) -> bool:
        """Return whether it is ours: also a missing folder, which its readers report, and one without locks."""
        try:
            descriptor = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return True
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            return not isinstance(error, BlockingIOError)
        return True
