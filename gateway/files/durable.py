"""Writes files atomically: after a power cut a file is the old or the new one, complete."""

import importlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

_NONBLOCK, _NOFOLLOW, _CLOEXEC = (getattr(os, f"O_{name}", 0) for name in ("NONBLOCK", "NOFOLLOW", "CLOEXEC"))
"""Windows has none of them, nor owners, modes and folders that can be synced."""


def staged_for(path: Path) -> Path:
    """Return the path of the temporary file that replaces `path`. The file remains only if the process was killed."""
    return path.with_name(f".{path.name}.new")


@contextmanager
def replacing(path: Path, staged: Path | None = None) -> Iterator[Path]:
    """Context for writing and syncing a temporary file, which then replaces `path`.

    If the block raises, the old file stays, and the temporary one is removed. Raises OSError.
    """
    staged = staged or staged_for(path)
    try:
        yield staged
        staged.replace(path)
        sync(path.parent)
    except BaseException as error:
        if isinstance(error, OSError):
            error.filename = error.filename or str(path)  # a full disk is found by a call that knows no name
        with suppress(OSError):
            staged.unlink()
        raise


def read(path: Path, most_bytes: int) -> bytes | None:
    """Return a file's content; None: there is no file. Waits only for the disk: a FIFO is rejected without blocking.

    Raises OSError, and ValueError with a sentence if `path` is no regular file or has over `most_bytes`.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | _NONBLOCK | _CLOEXEC)
    except FileNotFoundError:
        return None
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise ValueError("is no regular file")
        with open(descriptor, "rb", closefd=False) as file:
            data = file.read(most_bytes + 1)
    finally:
        os.close(descriptor)
    if len(data) > most_bytes:
        raise ValueError(f"is larger than {most_bytes} bytes")
    return data


def write(path: Path, data: bytes, *, before: Callable[[], None] = lambda: None) -> None:
    """Write a file atomically; it is on the disk when this returns. Raises OSError. Blocks on the disk.

    `before` is called before the new file replaces the old one. Only one process may write the file at a time.
    """
    with replacing(path) as staged:
        with staged.open("wb") as file:
            _fill(file, data)
        before()


def write_with_mode(path: Path, data: bytes, mode: int, *, prepare: Callable[[int], None] = lambda _: None) -> None:
    """Like `write`, with exactly this mode. Several processes may write: the last wins. Raises OSError.

    `prepare` gets the descriptor of the new, empty file.
    """
    with replacing(path, path.with_name(f".{path.name}.{os.urandom(4).hex()}")) as staged:
        create(staged, data, mode, prepare=prepare)


def write_like_the_folder(path: Path, data: bytes, mode: int) -> None:
    """Like `write_with_mode`. As root, for the folder's owner: a service can go on writing it. Raises OSError."""
    write_with_mode(path, data, mode, prepare=partial(like_the_folder, path))


def create(path: Path, data: bytes, mode: int, *, prepare: Callable[[int], None]) -> None:
    """Write a new file with exactly this mode, regardless of the umask; all of it or none.

    The mode is set before the content is written, so that a key is never readable by others. Raises OSError, and
    FileExistsError if the file exists.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NOFOLLOW | _CLOEXEC, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            if hasattr(os, "fchmod"):
                os.fchmod(descriptor, mode)
            prepare(descriptor)
            _fill(file, data)
    except BaseException:
        with suppress(OSError):
            path.unlink()
        raise


def like_the_folder(path: Path, descriptor: int) -> None:
    """If root, give the open file to the owner of its folder, so that the service can write it. Raises OSError."""
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        folder = path.parent.stat()
        os.fchown(descriptor, folder.st_uid, folder.st_gid)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Context that only one process and thread at a time enters for `path`; waits for the others. Raises OSError.

    The lock is on a second file (`.lock`), since writers replace the first.
    """
    with os.fdopen(os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | _CLOEXEC, 0o600)) as file:
        like_the_folder(path, file.fileno())
        try:
            fcntl: Any = importlib.import_module("fcntl")
        except ImportError:
            windows: Any = importlib.import_module("msvcrt")
            windows.locking(file.fileno(), windows.LK_LOCK, 1)
        else:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX)
        yield


def sync(path: Path) -> None:
    """Sync a file's content, or a folder's entries, to the disk. Raises OSError."""
    if not hasattr(os, "O_DIRECTORY") and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _fill(file: BinaryIO, data: bytes) -> None:
    file.write(data)
    file.flush()
    os.fsync(file.fileno())
