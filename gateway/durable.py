"""Files that a power cut leaves whole, as they were or as they are to be: robots and laptops lose power."""

import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


def _nothing(_descriptor: int) -> None:
    pass


def staged_for(path: Path) -> Path:
    """The file that is written, and then takes the other's place. It stays only while, or where, that did not end."""
    return path.with_name(f".{path.name}.new")


@contextmanager
def replacing(path: Path, staged: Path | None = None) -> Iterator[Path]:
    """For a block that writes another file, and syncs it: at the end that takes the place of the one at `path`.

    Where the block raises, the old one stays, and the other is removed. Raises OSError.
    """
    staged = staged or staged_for(path)
    try:
        yield staged
        staged.replace(path)
        sync(path.parent)
    except BaseException:
        with suppress(OSError):
            staged.unlink()
        raise


def write(
    path: Path,
    data: bytes,
    *,
    prepare: Callable[[int], None] = _nothing,
    before: Callable[[], None] = lambda: None,
) -> None:
    """Write a file: it is on the disk when this returns, or the old one stays. Raises OSError. As slow as the disk is.

    `prepare` is given the new file's descriptor, while it is empty; `before` is called before it takes its place.
    Only one process may write it at a time.
    """
    with replacing(path) as staged:
        with staged.open("wb") as file:
            _fill(file, data, prepare)
        before()


def write_with_mode(path: Path, data: bytes, mode: int, *, prepare: Callable[[int], None] = _nothing) -> None:
    """The same for a file with exactly this mode, which several processes may write at a time: the last one wins."""
    with replacing(path, path.with_name(f".{path.name}.{secrets.token_hex(4)}")) as staged:
        create(staged, data, mode, prepare=prepare)


def create(path: Path, data: bytes, mode: int, *, prepare: Callable[[int], None] = _nothing) -> None:
    """Write a new file with exactly this mode, whatever the umask. Raises OSError, FileExistsError.

    It has its mode before its content, so that a key is never readable by others.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(descriptor, mode)
        _fill(file, data, prepare)


def like_the_folder(path: Path, descriptor: int) -> None:
    """What root writes belongs to the folder's owner: the service must be able to write it later."""
    if os.geteuid() == 0:
        folder = path.parent.stat()
        os.fchown(descriptor, folder.st_uid, folder.st_gid)


def sync(path: Path) -> None:
    """Have what is in a file, or which files are in a folder, on the disk when this returns. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _fill(file: BinaryIO, data: bytes, prepare: Callable[[int], None]) -> None:
    prepare(file.fileno())
    file.write(data)
    file.flush()
    os.fsync(file.fileno())
