"""Locks on single bytes of a file. They belong to the open file, end with its process, and any process sees them.

A process's own lock (F_SETLK) would end whenever the process closes the file anywhere.
"""

import fcntl
import os
import struct
from typing import Final

_FLOCK: Final = struct.Struct("hhqqi4x")  # struct flock: type, whence, start, length, process


def lock(fd: int, kind: int, place: int = 0) -> bool:
    """Lock (F_WRLCK, F_RDLCK) or unlock (F_UNLCK) a byte, without waiting. Return whether that worked."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(kind, os.SEEK_SET, place, 1, 0))
    except OSError:
        return False
    return True


def is_locked(fd: int, place: int = 0) -> bool | None:
    """Return whether another opening has locked the byte, or None if not known."""
    try:
        answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, place, 1, 0))
    except OSError:  # the device is going away
        return None
    return bool(_FLOCK.unpack(answer)[0] != fcntl.F_UNLCK)
