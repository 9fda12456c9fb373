"""What the tests of certificates share: a folder as `init` leaves it, and ways to look at one."""

import base64
import datetime as dt
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.errors import ConfigError

HOSTS = ["robot.local", "192.0.2.7"]
NOW = dt.datetime.now(dt.UTC).replace(microsecond=0)
DAY = dt.timedelta(days=1)


@pytest.fixture(name="folder")
def make_folder(tmp_path: Path) -> Path:
    """Return a folder of certificates as `init` leaves it."""
    certs.folder.init(tmp_path / "D", HOSTS)
    return tmp_path / "D"


def names(directory: Path) -> set[str]:
    """Return everything in a folder, passing names too."""
    return {path.name for path in directory.iterdir()}


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def contents(directory: Path) -> dict[str, bytes]:
    return {str(path.relative_to(directory)): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def fault(call: Callable[[], object]) -> str:
    """Return the one line that a faulty call ends with."""
    with pytest.raises(ConfigError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def with_one_bit_changed(pem: bytes) -> Iterator[bytes]:
    """Yield the file for each bit of a PEM file's content, with this bit changed."""
    head, *lines, tail = pem.splitlines(keepends=True)
    der = base64.decodebytes(b"".join(lines))
    for bit in range(len(der) * 8):
        changed = bytearray(der)
        changed[bit // 8] ^= 1 << bit % 8
        yield head + base64.encodebytes(changed) + tail
