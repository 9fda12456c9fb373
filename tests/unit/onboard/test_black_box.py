"""`incidents`: its commands, and folders and disks that do not let it."""

import json
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from gateway.errors import ConfigError, GatewayError
from gateway.model import black_box as form
from gateway.model.black_box import RING_FILE
from gateway.onboard.black_box import BlackBox
from gateway.robot.blackbox import ring as rings
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.blackbox.ring import RecordRing
from gateway.robot.host.ownership import Ownership
from gateway.robot.settings import Settings
from tests.support.command import run_here
from tests.support.recordings import disk_that_takes
from tests.support.robot import WALL_NS

NAME = "20260921-141320-123-watchdog"


def settings(folder: Path) -> Settings:
    return Settings.of({"state": {"path": str(folder)}})


def box(folder: Path) -> BlackBox:
    return BlackBox(settings(folder))


@pytest.fixture
def ring_at(folder: Path) -> Path:
    """Return a ring with one incident, which the link in `folder` leads to."""
    path = rings.prepare(folder)
    ring = RecordRing(path, 100)
    ring.append(form.INCIDENT, 5, form.fields(WALL_NS, NAME))
    ring.close()
    return path


@pytest.mark.usefixtures("ring_at")
def test_an_incident_is_listed_shown_and_exported_by_its_name_or_as_the_last(folder: Path, tmp_path: Path) -> None:
    config, file = tmp_path / "gateway.toml", tmp_path / "stop.mcap"
    config.write_text(f'state.path = "{folder}"\n')

    def run(*arguments: str) -> tuple[int, str]:
        done = run_here("incidents", *arguments, "--config", str(config))
        return done.returncode, done.stdout

    code, story = run("show", "last")
    assert (code, story.startswith(f"{NAME}: ")) == (0, True)
    assert run("show", NAME) == (0, story)
    assert json.loads(run("show", NAME, "--json")[1]) == {"id": NAME, "story": story.splitlines()}
    assert [each["id"] for each in json.loads(run("list", "--json")[1])] == [NAME]
    assert run("export", "last", str(file)) == (0, f"{NAME} is in {file}\n")
    assert run("export", "last", str(file))[0] == 2, "it exists"
    assert run("show", "20200101-000000-000-estop")[0] == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="to become another user takes root")
@pytest.mark.parametrize("mode", [0o700, 0o755], ids=["a closed folder", "a closed ring"])
def test_a_black_box_that_this_user_may_not_read_is_not_reported_as_empty(mode: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o711)
        folder = Path(name) / "box"
        folder.mkdir()
        (folder / RING_FILE).touch(0o600)
        folder.chmod(mode)
        os.seteuid(65534)  # to root no folder is closed
        try:
            for call in (box(folder).list_all, partial(box(folder).show, "last")):
                with pytest.raises(ConfigError, match=r"Permission denied.*sudo"):
                    call()
        finally:
            os.seteuid(0)


@pytest.mark.skipif(os.geteuid() != 0, reason="to give a file away takes root")
@pytest.mark.parametrize(
    "spoil",
    [lambda ring: os.chown(ring, 65533, -1), lambda ring: ring.chmod(0o666), lambda ring: os.link(ring, f"{ring}-2")],
    ids=["another user's", "for all to write", "with another name"],
)
def test_a_ring_that_somebody_else_has_made_is_not_shown(
    folder: Path, ring_at: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[[Path], None]
) -> None:
    """The ring is in /dev/shm, where somebody may have made it before the gateway does."""
    os.chown(folder / RING_FILE, 65534, -1, follow_symlinks=False)
    os.chown(ring_at, 65534, -1)
    box(folder).list_all()
    assert NAME in capsys.readouterr().out, "root reads the ring of the link's own user"
    spoil(ring_at)
    with pytest.raises(ConfigError, match="another user has made this file, or may write to it"):
        box(folder).list_all()


def test_a_damaged_ring_is_not_taken_for_an_empty_one(folder: Path, ring_at: Path) -> None:
    ring_at.write_bytes(b"")
    with pytest.raises(ConfigError, match="it is empty: its gateway had no room for it"):
        box(folder).list_all()
    ring_at.write_bytes(bytes(100))
    with pytest.raises(ConfigError, match="it is no black box of this version"):
        box(folder).list_all()
    ring_at.unlink()
    with pytest.raises(GatewayError, match="no incidents in"):
        box(folder).show("last")


FORGED: list[tuple[int, bytes]] = [
    *((kind, rest) for kind in range(20) for rest in (b"", b"\xff" * 60, b"[]", b"[1, 2, 3, 4, 5, 6]", bytes(60))),
    (form.INCIDENT, form.fields(WALL_NS, "no-time-watchdog")),
    (form.INCIDENT, form.fields(2**70, NAME)),
    (form.START, form.fields(-(2**70), {})),
    (form.EVENT, form.fields("no_kind", None, None, None, "", 0)),
    (form.FRAME, form.frame(b"\xff" * 8, "no cause", 2**40, 2**40)),
    (form.NOTE, form.fields("mode", "1" * 90)),
]


@pytest.mark.parametrize("kind", range(20))
def test_a_forged_record_ends_in_no_traceback(folder: Path, ring_at: Path, kind: int, tmp_path: Path) -> None:
    for count, (forged, rest) in enumerate(each for each in FORGED if each[0] == kind):
        ring_at.unlink()
        ring = RecordRing(ring_at, 100)
        ring.append(form.INCIDENT, 5, form.fields(WALL_NS, NAME))
        ring.append(forged, 6, rest[:90])
        ring.append(forged, 2**63 - 1, rest[:90])
        ring.close()
        for call in (
            box(folder).list_all,
            partial(box(folder).show, "last"),
            partial(box(folder).export, NAME, tmp_path / f"{count}.mcap"),
        ):
            with suppress(GatewayError):
                call()


@pytest.mark.skipif(os.geteuid() != 0, reason="to give a file away takes root")
def test_a_ring_file_of_another_user_is_not_used(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    ring_at = rings.prepare(folder)
    ring_at.touch()
    os.chown(ring_at, 65533, -1)
    path = rings.prepare(folder)
    assert path != ring_at
    ring = RecordRing(path, 100)
    ring.append(form.INCIDENT, 5, form.fields(WALL_NS, NAME))
    ring.close()
    assert rings.prepare(folder) == path, "the next run goes on with it"
    box(folder).list_all()
    assert NAME in capsys.readouterr().out


def test_without_a_writable_folder_in_memory_the_ring_is_in_the_state_folder(
    folder: Path, ring_at: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link of an earlier run led elsewhere."""
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    monkeypatch.setattr(os, "access", lambda *_: False)
    path = rings.prepare(folder)
    assert path != ring_at
    RecordRing(path, 100).close()
    assert not path.is_symlink()


def test_a_ring_without_room_is_named_in_the_log(folder: Path, ring_at: Path, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(settings(folder), {}, time.monotonic_ns, time.time_ns)
    with disk_that_takes(50):
        recorder.open(Ownership())
    assert f"the black box is off: {ring_at}: File too large" in caplog.text
    with pytest.raises(ConfigError, match="it is empty"):
        box(folder).list_all()


@pytest.mark.usefixtures("ring_at")
def test_a_full_disk_keeps_no_half_of_an_export(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "stop.mcap"

    with disk_that_takes(50), pytest.raises(ConfigError, match="File too large"):
        box(folder).export(NAME, copy)
    assert not copy.exists()
    copy.write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        box(folder).export(NAME, copy)
    assert copy.read_text() == "mine"
