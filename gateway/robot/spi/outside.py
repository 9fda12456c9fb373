"""Record locks on two bytes of the device, by which a running gateway and `stop-servos` notice each other.

`stop-servos` locks the byte AT_WORK from its first Stops on. A gateway locks the byte UNSEEN once it has the device,
and unlocks it while AT_WORK is locked. `stop-servos` ends when UNSEEN is unlocked: a gateway has noticed, or none runs.
Locks need no rights except those on the device, and end with their process.
"""

import fcntl
import os
import time
from contextlib import suppress
from typing import Final

from gateway.host.file_lock import is_locked, lock

PATIENCE_S: Final = 0.5
"""How long `stop-servos` waits to be noticed. A gateway polls ten times a second; a hanging one is not waited for."""
_POLL_S: Final = 0.002
_AT_WORK, _UNSEEN = 2, 3  # bytes of the device


class Listener:
    """The gateway's side, on its open device."""

    def __init__(self, fd: int) -> None:
        """Lock the device. Raises BlockingIOError if another gateway has it."""
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._fd = fd
        self._waits = lock(fd, fcntl.F_WRLCK, _UNSEEN)

    def poll(self) -> bool | None:
        """Return whether `stop-servos` is at work, or None if not known. Takes some microseconds, never raises."""
        # UNSEEN before AT_WORK: if `stop-servos` finds UNSEEN free after its last Stop, a poll has seen it at work.
        self._waits = self._waits or lock(self._fd, fcntl.F_WRLCK, _UNSEEN)
        at_work = is_locked(self._fd, _AT_WORK)
        if at_work:
            self._waits = not lock(self._fd, fcntl.F_UNLCK, _UNSEEN)
        return at_work


class Notice:
    """The side of `stop-servos`. It has its own descriptor, since each round of Stops reopens the device."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._fd: int | None = None
        self.gateway_runs = False

    def give(self) -> None:
        """Lock AT_WORK, if there is a device. Never raises: the Stops matter more."""
        if self._fd is None:
            with suppress(OSError):
                self._fd = os.open(self._path, os.O_RDWR | os.O_CLOEXEC)
                lock(self._fd, fcntl.F_RDLCK, _AT_WORK)  # shared: two may be at work
                self.gateway_runs = is_locked(self._fd, _UNSEEN) is not False  # if not known, wait for a gateway

    def end(self) -> bool:
        """Wait until a gateway has noticed, then unlock AT_WORK. Return whether it did. Call it after all Stops."""
        if self._fd is None:
            return True
        give_up_s = time.monotonic() + PATIENCE_S
        seen = self._wait_for(self._fd, give_up_s, unseen=False)
        lock(self._fd, fcntl.F_UNLCK, _AT_WORK)
        if self.gateway_runs and seen:
            self._wait_for(self._fd, give_up_s, unseen=True)  # the gateway has seen the end and takes starts again
        os.close(self._fd)
        self._fd = None
        return seen

    @staticmethod
    def _wait_for(fd: int, give_up_s: float, *, unseen: bool) -> bool:
        while is_locked(fd, _UNSEEN) is not unseen:
            if time.monotonic() > give_up_s:
                return False
            time.sleep(_POLL_S)
        return True


def is_gateways(path: str, *, unknown: bool = True) -> bool:
    """Return whether a gateway has locked the device; `unknown` if the kernel does not show it.

    Raises OSError if the device does not open.
    """
    fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        locked = is_locked(fd, _UNSEEN)
        return unknown if locked is None else locked
    finally:
        os.close(fd)
