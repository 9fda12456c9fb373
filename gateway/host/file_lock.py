"""A lock for a file's only writer. It ends with its process, and readers can see whether a writer runs."""

import fcntl
import os
import struct
from typing import Final

_FLOCK: Final = struct.Struct("hhqqi4x")  # struct flock: type, whence, start, length, process


def lock_to_write(fd: int) -> None:
    """Become the file's only writer, until this descriptor is closed. Raises OSError if another process is."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 1, 0))
    except OSError as error:
        raise OSError(error.errno, "another gateway writes to it") from error


def written_by_anyone(fd: int) -> bool:
    """Return whether a process has called `lock_to_write` for this file and still runs."""
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _FLOCK.pack(fcntl.F_RDLCK, os.SEEK_SET, 0, 1, 0))
    return bool(_FLOCK.unpack(answer)[0] != fcntl.F_UNLCK)
