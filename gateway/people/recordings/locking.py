"""Who writes a file holds a lock on it, where the system has such locks; it ends with its process."""

from contextlib import suppress

from gateway.errors import ConfigError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def locked(fd: int) -> None:
    """Take the lock. Raises ConfigError where another program writes this file."""
    if fcntl is None:
        return
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ConfigError("another program is writing this file") from error
    except OSError:  # a file system without locks
        return


def in_use(fd: int) -> bool:
    """Whether another program writes this file."""
    if fcntl is None:
        return False
    with suppress(OSError):
        try:
            fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        fcntl.flock(fd, fcntl.LOCK_UN)
    return False
