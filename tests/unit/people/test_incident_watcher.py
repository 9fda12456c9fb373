"""hexapod-recorder: which incidents are kept on the disk, when, and how many."""

import asyncio
import logging
import os
from dataclasses import replace
from io import FileIO
from pathlib import Path

import pytest

from gateway.model.black_box import format as form
from gateway.model.black_box.files import INCIDENTS_FOLDER, RING_FILE
from gateway.onboard import black_box
from gateway.people.incidents import archive, ring_reader, watcher
from gateway.people.incidents.incidents import Incident, is_id
from gateway.people.incidents.watcher import IncidentWatcher
from gateway.people.recordings import read
from gateway.robot.blackbox.ring import RecordRing
from gateway.robot.settings import Settings
from schemas import keys
from tests.support.robot import WALL_NS
from tests.unit.people.test_incidents import LEG_3, START, records, silence
from tests.unit.people.test_recorder import recorded

pytestmark = pytest.mark.virtual_time


def filled(folder: Path, count: int, size: int = 10) -> None:
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"20260921-141320-{number:03d}-watchdog.mcap").write_bytes(b"x" * size)


def test_the_newest_hundred_and_two_hundred_megabytes_are_kept(tmp_path: Path) -> None:
    folder = tmp_path / "incidents"
    filled(folder, 105)
    (folder / "mine.mcap").write_text("not an incident's")
    archive.prune(folder)
    names = [each.name for each in archive.kept(folder)]
    assert (len(names), names[0][-12:], names[-1][-12:]) == (100, "005-watchdog", "104-watchdog")
    assert (folder / "mine.mcap").exists()
    for number in range(100, 105):
        os.truncate(folder / f"20260921-141320-{number}-watchdog.mcap", 60_000_000)  # no blocks, only the size
    archive.prune(folder)
    assert [each.name[-12:] for each in archive.kept(folder)] == ["102-watchdog", "103-watchdog", "104-watchdog"]


def test_which_is_the_newest_is_what_happened_last_and_not_what_a_clock_said(tmp_path: Path) -> None:
    """A Raspberry Pi's clock starts where it was switched off, or in 1970."""
    folder = tmp_path / "incidents"
    filled(folder, 100)
    incident = Incident("19700101-000010-000-estop", 9, 1, 20, 0, whole=True)
    none = records()
    path = archive.keep(folder, incident, none)
    archive.prune(folder)
    names = [each.name for each in archive.kept(folder)]
    assert (len(names), names[0][-12:], names[-1]) == (100, "001-watchdog", incident.name)
    before = replace(incident, name="19700101-000020-000-estop")
    archive.keep(folder, before, none, later=[incident.name])
    archive.keep(folder, replace(incident, name="19700101-000001-000-crash"), none)
    archive.keep(folder, incident, none, over=False)
    archive.prune(folder)
    last = ["19700101-000020-000-estop", incident.name, "19700101-000001-000-crash"]
    assert [each.name for each in archive.kept(folder)][-3:] == last, "and each stays where it is"
    os.utime(path, ns=(0, 2**62))
    assert not archive.is_kept(folder, incident), "it was written before its end"
    os.utime(path, ns=(0, 0))
    assert archive.is_kept(folder, before)
    for damaged in (b"\xff\0" * 100, b"x" * 10**6, b""):
        (folder / "order").write_bytes(damaged)
        assert len(archive.kept(folder)) == 100


async def test_after_the_clock_was_set_back_the_last_is_still_what_happened_last(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    filled(folder / INCIDENTS_FOLDER, 100)
    settings = Settings.model_validate({"state": {"path": str(folder)}})
    first = recorded(folder)
    first.put(keys.ESTOP)
    first.conductor.recorder.close()
    keeper = IncidentWatcher(folder, clock=first.now_ns)
    (kept_first,) = keeper.keep(whole_only=False)
    later = recorded(folder)
    recorder = later.conductor.recorder
    recorder._wall_ns = lambda: WALL_NS - 10**18
    later.put(keys.ESTOP, {"source": "bert"})
    black_box.list_all(settings)
    in_ring = capsys.readouterr().out.splitlines()[0].split()[0]
    assert in_ring.startswith("1995"), "in the ring"
    await asyncio.sleep(6)
    (path,) = [each for each in keeper.look() if each != kept_first]
    assert (path.stem, path.exists()) == (in_ring, True)
    assert not keeper.look()
    black_box.list_all(settings)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[:2]] == [in_ring, kept_first.stem]
    black_box.show(settings, "last")
    assert capsys.readouterr().out.startswith(in_ring)


async def test_the_keeper_waits_until_nothing_can_be_added_and_keeps_it_once(folder: Path) -> None:
    robot = recorded(folder)
    keeper = IncidentWatcher(folder, clock=robot.now_ns)
    assert keeper.look() == []
    await silence(robot)
    assert keeper.look() == []
    await asyncio.sleep(4.5)
    (path,) = keeper.look()
    assert is_id(path.stem)
    assert keeper.look() == []
    assert IncidentWatcher(folder, clock=robot.now_ns).look() == [], "a keeper that is started again knows what is kept"
    robot.put(keys.ESTOP)
    robot.conductor.recorder.close()
    await asyncio.sleep(0)
    (path,) = keeper.look()
    assert path.stem.endswith("-estop"), "a gateway that has ended adds nothing"


async def test_the_keeper_misses_no_gateway_that_was_killed_between_two_of_its_looks(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "gateway.people.incidents.watcher")
    first = recorded(folder)
    first.conductor.recorder.ended("a restart")
    first.conductor.recorder.close()
    keeper = IncidentWatcher(folder, clock=first.now_ns)
    assert keeper.look() == []
    recorded(folder).conductor.recorder.close()  # it ends without a word
    assert keeper.look() == [], "its incident is not whole"
    await asyncio.sleep(6)
    (path,) = keeper.look()
    assert path.stem.endswith("-crash")
    (path.parent / "order").write_text(f"{path.stem} open\n")  # as if it was written before its end
    assert IncidentWatcher(folder, clock=first.now_ns).look() == [path]
    assert len([entry for entry in caplog.records if "is kept" in entry.message]) == 1, "the log names it once"


async def test_once_keeps_what_is_there_and_more_comes_later(folder: Path) -> None:
    robot = recorded(folder)
    await silence(robot)
    keeper = IncidentWatcher(folder, clock=robot.now_ns)
    (path,) = keeper.keep(whole_only=False)
    before = path.stat().st_size
    os.utime(path, ns=(0, WALL_NS))
    robot.put(LEG_3, START)
    await asyncio.sleep(7)
    (path,) = IncidentWatcher(folder, clock=robot.now_ns).look()
    assert path.stat().st_size > before


async def test_a_full_disk_is_reported_once_and_leaves_nothing_behind(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    robot = recorded(folder)
    await silence(robot)
    await asyncio.sleep(5)

    class Full(FileIO):
        def write(self, _: object) -> int:
            raise OSError(28, "No space left on device")

    caplog.set_level(logging.WARNING, "gateway.people.incidents.watcher")
    keeper = IncidentWatcher(folder, clock=robot.now_ns)
    with monkeypatch.context() as patched:
        patched.setattr("gateway.people.recordings.writing.FileIO", Full)
        assert keeper.keep(whole_only=True) == keeper.keep(whole_only=True) == []
    said = [entry.message for entry in caplog.records if "kept" in entry.message]
    assert len(said) == 1
    assert said[0].endswith("cannot be kept: No space left on device")
    assert list((folder / INCIDENTS_FOLDER).iterdir()) == []
    assert len(keeper.keep(whole_only=True)) == 1


# ---- the end of a gateway is kept first: only the newest part of the ring is read for it, and then the rest


S = 1_000_000_000
SLOTS = 256
BEGAN_NS = 1_790_000_000 * S
LATE_NS = 1000 * S


def ring(folder: Path, seconds: int, *incidents: tuple[int, str]) -> Path:
    """A gateway that was killed after so long; each second the clock and a lag, and these incidents."""
    made = RecordRing(folder / RING_FILE, SLOTS)
    made.append(form.START, 0, form.start(BEGAN_NS, {"pid": 1}))
    for second in range(1, seconds + 1):
        made.append(form.CLOCK, second * S, form.number(BEGAN_NS + second * S))
        made.append(form.LAG, second * S, form.number(second))
        for at_s, name in incidents:
            if at_s == second:
                made.append(form.INCIDENT, second * S, form.incident(BEGAN_NS + second * S, name))
    made.close()
    return folder / RING_FILE


def kept(folder: Path) -> dict[str, list[int]]:
    """The incidents by how their names end, and the times of what their files hold."""
    files = sorted((folder / INCIDENTS_FOLDER).glob("*.mcap"))
    return {path.stem.split("-", 3)[-1]: [message.time_ns for message in read(path)] for path in files}


@pytest.mark.parametrize("seconds", [5, 50, 300])
@pytest.mark.parametrize("most", [1, 7, SLOTS - 1, SLOTS, 1000])
def test_the_newest_slots_hold_the_newest_records(tmp_path: Path, seconds: int, most: int) -> None:
    path = ring(tmp_path, seconds)
    whole, newest = ring_reader.read(path), ring_reader.read(path, most)
    assert list(newest.records) == list(whole.records)[-most:]
    assert (newest.damaged, newest.missing) == (0, 0)


def test_a_torn_newest_record_hides_none_before_it(tmp_path: Path) -> None:
    path = ring(tmp_path, 100)
    last = ring_reader.read(path).records[-1].sequence
    data = bytearray(path.read_bytes())
    data[form.HEADER_BYTES + last % SLOTS * form.SLOT] ^= 1
    records, _, _ = ring_reader.parse(bytes(data), 3)
    assert [each.sequence for each in records] == [last - 3, last - 2, last - 1]


def test_the_end_is_kept_before_the_ring_is_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ring(tmp_path, 60, (20, "20260921-134700-000-estop"), (50, "20260921-134730-000-watchdog"))
    monkeypatch.setattr(watcher, "NEWEST", 30)
    IncidentWatcher(tmp_path, lambda: LATE_NS).keep(whole_only=False, most=watcher.NEWEST)
    first = kept(tmp_path)
    assert first.keys() == {"watchdog", "crash"}, "the emergency stop is further back"
    IncidentWatcher(tmp_path, lambda: LATE_NS).keep_all()
    second = kept(tmp_path)
    assert second.keys() == {"estop", "watchdog", "crash"}
    assert len(second["watchdog"]) > len(first["watchdog"]), "what it lacked is in it now"
    assert second["crash"] == first["crash"]
