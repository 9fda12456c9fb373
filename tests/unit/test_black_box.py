"""`incidents` at folders and disks that do not let it."""

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.recorder import place
from gateway.settings import Settings
from gateway.tools import black_box

NAME = "20260921-141320-123-watchdog"


def settings(folder: Path) -> Settings:
    return Settings.model_validate({"recorder": {"path": str(folder)}})


@contextmanager
def nobody() -> Iterator[None]:
    """To root no folder is closed."""
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.mark.skipif(os.geteuid() != 0, reason="to become another user takes root")
@pytest.mark.parametrize("mode", [0o700, 0o755], ids=["a closed folder", "a closed ring"])
def test_who_may_not_read_it_is_not_told_that_there_is_nothing(mode: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o711)
        folder = Path(name) / "box"
        folder.mkdir()
        (folder / place.RING).touch(0o600)
        folder.chmod(mode)
        with nobody():
            for call in (black_box.list_all, lambda found: black_box.show(found, "last")):
                with pytest.raises(ConfigError, match=r"Permission denied.*sudo"):
                    call(settings(folder))


def test_a_disk_that_gets_full_is_left_without_half_an_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path / place.INCIDENTS / f"{NAME}.mcap"
    kept.parent.mkdir()
    kept.write_bytes(b"an incident")
    copy = tmp_path / "stop.mcap"

    def full(_path: Path) -> bytes:
        assert copy.exists(), "it was begun"
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "read_bytes", full)
    with pytest.raises(ConfigError, match="No space left on device"):
        black_box.export(settings(tmp_path), NAME, copy)
    assert not copy.exists()
    copy.write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        black_box.export(settings(tmp_path), NAME, copy)
    assert copy.read_text() == "mine"
