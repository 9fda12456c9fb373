"""What the tests of certificates share: a folder as `init` leaves it, and ways to look at one."""

import datetime as dt
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway import certs
from gateway.errors import ConfigError

HOSTS = ["robot.local", "192.0.2.7"]
NOW = dt.datetime.now(dt.UTC).replace(microsecond=0)
DAY = dt.timedelta(days=1)
MADE_BY_INIT = {"ca.key", "ca.pem", "gateway.key", "gateway.pem", "gateway.json5"}


@pytest.fixture(name="folder")
def make_folder(tmp_path: Path) -> Path:
    """A folder of certificates as `init` leaves it."""
    certs.init(tmp_path / "D", HOSTS, now=NOW)
    return tmp_path / "D"


def names(directory: Path) -> set[str]:
    """Everything in a folder, passing names too."""
    return {path.name for path in directory.iterdir()}


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def fault(call: Callable[[], object]) -> str:
    """The one line that a faulty call ends with."""
    with pytest.raises(ConfigError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)
