"""hexapod-recorder: which incidents are kept on the disk, when, and how many."""

import asyncio
import logging
import os
from pathlib import Path

import pytest

from gateway.recorder import kept, place
from gateway.recorder.incidents import is_id
from gateway.recorder.keeper import Keeper
from schemas import keys
from tests.support.robot import WALL_NS
from tests.unit.test_incidents import LEG_3, START, silence
from tests.unit.test_recorder import recorded


def filled(folder: Path, count: int, size: int = 10) -> None:
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"20260921-141320-{number:03d}-watchdog.mcap").write_bytes(b"x" * size)


def test_the_newest_hundred_and_two_hundred_megabytes_are_kept(tmp_path: Path) -> None:
    folder = tmp_path / "incidents"
    filled(folder, 105)
    (folder / "mine.mcap").write_text("not an incident's")
    kept.prune(folder)
    names = [each.name for each in kept.kept(folder)]
    assert (len(names), names[0][-12:], names[-1][-12:]) == (100, "005-watchdog", "104-watchdog")
    assert (folder / "mine.mcap").exists()
    for number in range(100, 105):
        os.truncate(folder / f"20260921-141320-{number}-watchdog.mcap", 60_000_000)  # no blocks, only the size
    kept.prune(folder)
    assert [each.name[-12:] for each in kept.kept(folder)] == ["102-watchdog", "103-watchdog", "104-watchdog"]


@pytest.mark.virtual_time
async def test_the_keeper_waits_until_nothing_can_be_added_and_keeps_it_once(folder: Path) -> None:
    robot = recorded(folder)
    keeper = Keeper(folder, clock=robot.now_ns)
    assert keeper.look() == []
    await silence(robot)
    assert keeper.look() == []
    await asyncio.sleep(4.5)
    (path,) = keeper.look()
    assert is_id(path.stem)
    assert keeper.look() == []
    assert Keeper(folder, clock=robot.now_ns).look() == [], "a keeper that is started again knows what is kept"
    robot.put(keys.ESTOP)
    robot.conductor.recorder.close()
    await asyncio.sleep(0)
    (path,) = keeper.look()
    assert path.stem.endswith("-estop"), "a gateway that has ended adds nothing"


@pytest.mark.virtual_time
async def test_the_keeper_misses_no_gateway_that_was_killed_between_two_of_its_looks(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "gateway.recorder.keeper")
    first = recorded(folder)
    first.conductor.recorder.ended("a restart")
    first.conductor.recorder.close()
    keeper = Keeper(folder, clock=first.now_ns)
    assert keeper.look() == []
    recorded(folder).conductor.recorder.close()  # it ends without a word
    assert keeper.look() == [], "its incident is not whole"
    await asyncio.sleep(6)
    (path,) = keeper.look()
    assert path.stem.endswith("-crash")
    os.utime(path, ns=(0, WALL_NS))
    assert Keeper(folder, clock=first.now_ns).look() == [path]
    assert len([entry for entry in caplog.records if "is kept" in entry.message]) == 1, "the log names it once"


@pytest.mark.virtual_time
async def test_once_keeps_what_is_there_and_more_comes_later(folder: Path) -> None:
    robot = recorded(folder)
    await silence(robot)
    keeper = Keeper(folder, clock=robot.now_ns)
    (path,) = keeper.keep(whole_only=False)
    before = path.stat().st_size
    os.utime(path, ns=(0, WALL_NS))
    robot.put(LEG_3, START)
    await asyncio.sleep(7)
    (path,) = Keeper(folder, clock=robot.now_ns).look()
    assert path.stat().st_size > before


@pytest.mark.virtual_time
async def test_a_full_disk_is_said_once_and_leaves_nothing_behind(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    robot = recorded(folder)
    await silence(robot)
    await asyncio.sleep(5)

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    caplog.set_level(logging.WARNING, "gateway.recorder.keeper")
    keeper = Keeper(folder, clock=robot.now_ns)
    with monkeypatch.context() as patched:
        patched.setattr("gateway.recordings.writing.os.write", full)
        assert keeper.keep(whole_only=True) == keeper.keep(whole_only=True) == []
    said = [entry.message for entry in caplog.records if "kept" in entry.message]
    assert len(said) == 1
    assert said[0].endswith("cannot be kept: No space left on device")
    assert list((folder / place.INCIDENTS).iterdir()) == []
    assert len(keeper.keep(whole_only=True)) == 1
