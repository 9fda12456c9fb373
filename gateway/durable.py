"""Files that a power cut leaves whole, as they were or as they are to be: robots and laptops lose power."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path


def staged_for(path: Path) -> Path:
    """The file that is written, and then takes the other's place. It stays only while, or where, that did not end."""
    return path.with_name(f".{path.name}.new")


def write(
    path: Path,
    data: bytes,
    *,
    prepare: Callable[[int], None] = lambda _: None,
    before: Callable[[], None] = lambda: None,
) -> None:
    """Write a file: it is on the disk when this returns, or the old one stays. Raises OSError. As slow as the disk is.

    `prepare` is given the new file's descriptor, while it is empty; `before` is called before it takes its place.
    """
    staged = staged_for(path)
    try:
        with staged.open("wb") as file:
            prepare(file.fileno())
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        before()
        staged.replace(path)
        sync(path.parent)
    except OSError:
        with suppress(OSError):
            staged.unlink()
        raise


def sync(path: Path) -> None:
    """Have what is in a file, or which files are in a folder, on the disk when this returns. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
