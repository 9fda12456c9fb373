"""Writes several files together: all of them appear, complete, or none. Never changes a file that exists."""

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
    """A file's content and mode."""

    data: bytes
    mode: int = PUBLIC


def publish(files: Mapping[Path, Content]) -> None:
    """Writes `files` in their order. Raises ConfigError if one exists or cannot be written, and then leaves none.

    Each file is first written under a temporary name in the same folder, then hard-linked to its own. Unlike a rename,
    a hard link fails when the name exists, so two runs at once cannot overwrite each other's keys.
    """
    token = secrets.token_hex(4)
    staged = {path: path.with_name(f".{path.name}.{token}") for path in files}
    undo = contextlib.ExitStack()  # undoes everything on failure
    with undo, contextlib.ExitStack() as passing:  # temporary names go first: only an empty directory can be removed
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
    """Replaces the content of the file at `path` in one step: certificates and router.json5, never keys."""
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
    # A failure here must not hide the one that led here.
    with contextlib.suppress(OSError):
        path.unlink()


def _remove_if_empty(directory: Path) -> None:
    with contextlib.suppress(OSError):
        directory.rmdir()


def _sync(directory: Path) -> None:
    """Writes the directory to disk at once: robots and laptops lose power."""
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
