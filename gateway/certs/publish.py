"""Writes several files as one deed: all of them appear, whole, or none does; what is already there is never touched."""

import contextlib
import os
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from gateway.errors import ConfigError

SECRET = 0o600
PUBLIC = 0o644


@dataclass(frozen=True)
class Content:
    """What a file shall hold and who may read it."""

    data: bytes
    mode: int = PUBLIC


def publish(files: Mapping[Path, Content]) -> None:
    """Writes `files` in their order; ConfigError if one exists or cannot be written, and then none is left.

    Each is first written beside its place under a passing name, then linked into place: a hard link, unlike a rename,
    fails when the name is taken, so two runs at once cannot overwrite one another's keys.
    """
    token = secrets.token_hex(4)
    staged = {path: path.with_name(f".{path.name}.{token}") for path in files}
    undo = contextlib.ExitStack()  # what to take back on failure
    with undo, contextlib.ExitStack() as passing:  # passing names go first: a directory is removed empty
        for path, content in files.items():
            with _explained(path):
                _make_directory(path.parent, undo)
                passing.callback(_discard, staged[path])
                _write(staged[path], content)
        for path in files:
            with _explained(path):
                os.link(staged[path], path)
            undo.callback(_discard, path)
        for directory in {path.parent for path in files}:
            with _explained(directory):
                _sync(directory)
        undo.pop_all()


def replace(path: Path, content: Content) -> None:
    """Puts new content in the place of the file at `path`, in one step. For certificates only: keys stay."""
    staged = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    with _explained(path), contextlib.ExitStack() as passing:
        passing.callback(_discard, staged)
        _write(staged, content)
        staged.replace(path)
        _sync(path.parent)


def _write(path: Path, content: Content) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, SECRET)
    with os.fdopen(descriptor, "wb") as file:
        # Exactly this mode, whatever the umask; before the content, so that a key is never readable by others.
        os.fchmod(descriptor, content.mode)
        if os.fstat(descriptor).st_mode & 0o777 != content.mode:
            raise ConfigError(
                f"{path.parent} cannot keep a file private (FAT?): choose a directory on a Linux file system"
            )
        file.write(content.data)
        file.flush()
        os.fsync(descriptor)


def _make_directory(directory: Path, undo: contextlib.ExitStack) -> None:
    """Makes what is missing of `directory`, each level readable by its owner only."""
    missing = [parent for parent in (directory, *directory.parents) if not parent.exists()]
    for parent in reversed(missing):
        parent.mkdir(mode=0o700)
        undo.callback(_remove_if_empty, parent)


def _discard(path: Path) -> None:
    # Taking back must not hide what went wrong before it.
    with contextlib.suppress(OSError):
        path.unlink()


def _remove_if_empty(directory: Path) -> None:
    with contextlib.suppress(OSError):
        directory.rmdir()


def _sync(directory: Path) -> None:
    """Puts the new names on the disk, not only in memory: robots and laptops lose power."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except FileExistsError as error:
        raise ConfigError(
            f"{path} exists and is never overwritten: choose another name, or move it away first"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"cannot write {path}: {error.strerror}; choose a directory that you may write to, or run this as its owner"
        ) from error
