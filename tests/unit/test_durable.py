"""Files are replaced whole, or stay as they were."""

import errno
import os
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from gateway.files import durable


def with_replacing(path: Path, data: bytes) -> None:
    """As those do it who write piece by piece."""
    with durable.replacing(path) as staged:
        staged.write_bytes(data)
        durable.sync(staged)


WRITERS = [durable.write, partial(durable.write_with_mode, mode=0o640), with_replacing]
Writer = Callable[[Path, bytes], None]


def no_space(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("broken_call", [(os, "fsync"), (Path, "replace")])
def test_a_full_disk_leaves_the_old_one_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Writer, broken_call: tuple[object, str]
) -> None:
    path = tmp_path / "file"
    write(path, b"old")
    assert path.read_bytes() == b"old"
    with monkeypatch.context() as broken:
        broken.setattr(*broken_call, no_space)
        with pytest.raises(OSError, match="No space left"):
            write(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("write", WRITERS)
def test_the_file_is_on_the_disk_before_it_takes_its_place_and_the_folder_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Writer
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    synced: list[tuple[int | None, bytes]] = []

    def fsync(descriptor: int) -> None:
        status = os.fstat(descriptor)
        synced.append((status.st_size if stat.S_ISREG(status.st_mode) else None, path.read_bytes()))

    monkeypatch.setattr(os, "fsync", fsync)
    write(path, b"new")
    assert synced == [(3, b"old"), (None, b"new")]


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_the_mode_is_there_before_the_content_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    path = tmp_path / "file"
    path.touch(0o644)
    found: list[tuple[int, int]] = []

    def look(descriptor: int) -> None:
        status = os.fstat(descriptor)
        found.append((stat.S_IMODE(status.st_mode), status.st_size))

    before = os.umask(umask)
    try:
        durable.write_with_mode(path, b"secret", 0o604, prepare=look)
    finally:
        os.umask(before)
    assert found == [(0o604, 0)]
    assert stat.S_IMODE(path.stat().st_mode) == 0o604


def test_two_that_write_at_once_leave_one_whole_file(tmp_path: Path) -> None:
    """The second begins and ends within the first."""
    path = tmp_path / "file"
    durable.write_with_mode(
        path, b"first", 0o600, prepare=lambda _: durable.write_with_mode(path, b"the second", 0o600)
    )
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"first", [path])


def test_one_at_a_time_is_in_a_locked_block(tmp_path: Path) -> None:
    path = tmp_path / "count.json"
    path.write_text("0")

    def count_on(_: int) -> None:
        with durable.locked(path):
            path.write_text(str(int(path.read_text()) + 1))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(count_on, range(100)))
    assert path.read_text() == "100"
