"""What precedes an incident is copied when it is announced, and is read also after the ring has come round."""

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from gateway.files import durable
from gateway.model import black_box as form
from gateway.model.black_box import COPIED_SHARE, MOST_COPIES, RING_FILE, copies_of, copy_path
from gateway.onboard.black_box import BlackBox
from gateway.people.incidents import ring_reader as rec
from gateway.people.incidents.find import find
from gateway.rate_limit import NS_PER_S
from gateway.robot.blackbox import recorder
from gateway.robot.blackbox.recorder import SHARE, RecordShares
from gateway.robot.blackbox.ring import RecordRing
from gateway.robot.settings import Settings
from schemas import keys
from schemas.words import Mode
from tests.support.recordings import disk_that_takes, parse
from tests.support.robot import LEG_3, Robot, leg, servo
from tests.support.waiting import wait_until
from tests.unit.people.test_recorder import contents, recorded

SLOTS: Final = 163
FLOOD_S: Final = 190
"""All records that messages may make at 2 commands a second overwrite the ring in 170 s."""
SERVO: Final = keys.servo_command(31)
FLOODS: Final[dict[str, Callable[[Robot, int], None]]] = {
    "emergency stops": lambda robot, number: robot.put(keys.ESTOP, {"source": f"source {number % 300}"}),
    "Stops": lambda robot, number: robot.put(SERVO, servo("stop", source=f"button {number % 3}")),
    "rejected messages": lambda robot, number: robot.put(LEG_3, {"source": f"source {number}"}),
}


async def incident(robot: Robot) -> None:
    """Let Anna walk for a second, and Bert stop the robot."""
    robot.put(LEG_3, leg("start", 90, 45, 120, source="anna"))
    for number in range(10):
        await asyncio.sleep(0.1)
        robot.put(LEG_3, leg("set", 90, 45, 100 + number, source="anna"))
    robot.put(keys.ESTOP, {"source": "bert"})
    beat(robot)


def beat(robot: Robot) -> None:
    robot.conductor.recorder.beat(0)


def copied(folder: Path, count: int) -> list[Path]:
    """Return so many copies, once the thread has made them."""
    ring = (folder / RING_FILE).resolve()
    wait_until(lambda: len(copies_of(ring)) >= count)
    return copies_of(ring)


@pytest.mark.lengthy
@pytest.mark.virtual_time
@pytest.mark.parametrize("flood", FLOODS)
async def test_a_flood_that_overwrites_the_whole_ring_leaves_what_precedes_the_incident(
    folder: Path, flood: str, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = {"limits": {"leg_rate_hz": 2}, "state": {"path": str(folder)}}
    robot = recorded(folder, limits=settings["limits"])
    await incident(robot)
    ring = (folder / RING_FILE).resolve()
    assert copied(folder, 1) == [copy_path(ring, parse(ring.read_bytes())[-1].sequence - 1)], "all before the clock's"
    for second in range(FLOOD_S):
        for number in range(40):
            FLOODS[flood](robot, 40 * second + number)
        beat(robot)
        await asyncio.sleep(1)
    robot.conductor.recorder.close()
    assert len(copied(folder, 1)) == 1, "a flood makes no copies"
    ring_alone = parse((folder / RING_FILE).read_bytes())
    kept = any(getattr(each.content, "source", None) == "anna" for each in ring_alone)
    assert kept is flood.startswith("rejected"), "events of one kind have a limit of their own"
    assert len([each for each in contents(folder, rec.CommandRecord) if each.source == "anna"]) == 11
    assert any(each.incident for each in contents(folder, rec.WallTime))
    left_out = sum(int(each.detail.split()[0]) for each in contents(folder, rec.Noted) if each.what == "left_out")
    assert left_out > 1000, "and the ring says how much it lacks"
    first = find(rec.read(folder / RING_FILE))[0].name
    BlackBox(Settings.of(settings)).show(first)
    story = capsys.readouterr().out
    assert "anna sent 11 commands for leg 3" in story
    assert "Stop written to all legs (estop)" in story


SPOILS: Final[dict[str, Callable[[Path], object]]] = {
    "the disk is full": lambda _: None,  # the limit on a file's size stands for it
    "its name is taken": lambda ring: durable.staged_for(ring).mkdir(),
    "the ring is gone": lambda ring: ring.rename(ring.with_name("elsewhere")),
    "the ring is another file": lambda ring: [ring.rename(f"{ring}-moved"), ring.write_bytes(bytes(9000))],
}


@pytest.mark.virtual_time
@pytest.mark.parametrize("spoil", SPOILS)
async def test_a_copy_that_fails_is_logged_and_stops_nothing(
    folder: Path, spoil: str, caplog: pytest.LogCaptureFixture
) -> None:
    robot = recorded(folder)
    ring = (folder / RING_FILE).resolve()
    SPOILS[spoil](ring)
    with disk_that_takes(1000 if spoil == "the disk is full" else 10**9):
        await incident(robot)
        robot.conductor.recorder.close()
    robot.conductor.recorder.mistake("after the end")
    assert robot.conductor.recorder.incidents == 1
    assert copies_of(ring) == []
    assert not durable.staged_for(ring).is_file()
    said = [entry.message for entry in caplog.records if "incident" in entry.message]
    assert len(said) == 1
    assert said[0].startswith("the time before this incident is not copied, and is lost after a minute: ")


@pytest.mark.virtual_time
async def test_each_incident_of_a_robot_that_ran_is_copied_at_the_end_at_the_latest(folder: Path) -> None:
    robot = recorded(folder)
    for number in (1, 2):
        await incident(robot)
        robot.put(keys.RESET, {"estop": number})
    robot.conductor.recorder.close()
    assert len(copies_of((folder / RING_FILE).resolve())) == 2


# ---- a copy's bytes


def filled(ring: Path, last: int, first: int = 1) -> None:
    """Fill a ring with so many modes, numbered from 1."""
    made = RecordRing(ring, SLOTS)
    for number in range(first, last + 1):
        made.append(form.NOTE, number, form.fields("mode", str(number)))
    made.close()


def sequences(file: Path) -> list[int]:
    return [record.sequence for record in rec.read(file)]


@pytest.mark.parametrize("newest", [1, 5, 19, 20, 21, 162, 163, 164, 170, 1003])
def test_a_copy_has_the_newest_records_and_the_ring_goes_on_behind_them(tmp_path: Path, newest: int) -> None:
    ring = tmp_path / RING_FILE
    filled(ring, newest)
    recorder.copy(ring, newest)
    (copy,) = copies_of(ring)
    assert copy.stat().st_mode & 0o777 == 0o600
    records = parse(copy.read_bytes())
    kept = list(range(max(1, newest - SLOTS // COPIED_SHARE + 1), newest + 1))
    assert [record.sequence for record in records] == kept
    assert sequences(ring) == list(range(max(1, newest - SLOTS + 1), newest + 1)), "each once"
    for more in (SLOTS - 3, SLOTS + 50):
        filled(ring, newest + more, len(sequences(ring)) and sequences(ring)[-1] + 1)
        left = range(newest + more - SLOTS + 1, newest + more + 1)
        assert sequences(ring) == [*(each for each in kept if each < left.start), *(each for each in left if each > 0)]


@pytest.mark.parametrize("bytes_left", [0, 5000])
def test_a_copy_that_is_not_whole_is_left_out(tmp_path: Path, bytes_left: int) -> None:
    ring = tmp_path / RING_FILE
    filled(ring, 100)
    recorder.copy(ring, 100)
    filled(ring, 400, 101)
    assert sequences(ring)[0] == 81
    os.truncate(copies_of(ring)[0], bytes_left)
    assert sequences(ring) == list(range(401 - SLOTS, 401))


def test_the_newest_copies_are_kept(tmp_path: Path) -> None:
    ring = tmp_path / RING_FILE
    filled(ring, 100)
    for newest in range(50, 70):
        recorder.copy(ring, newest)
    assert copies_of(ring) == [copy_path(ring, newest) for newest in range(70 - MOST_COPIES, 70)]


def test_half_a_copy_of_a_process_that_was_killed_is_in_nobodys_way(tmp_path: Path) -> None:
    ring = tmp_path / RING_FILE
    filled(ring, 1000)
    durable.staged_for(ring).write_bytes(b"half")
    assert copies_of(ring) == []
    recorder.copy(ring, 1000)
    assert copies_of(ring) == [copy_path(ring, 1000)]
    assert not durable.staged_for(ring).exists()


# ---- how many records each source may make: a flood overwrites nothing that precedes an incident, and hides nobody


def test_one_source_leaves_some_for_others_and_what_is_left_out_is_counted_once() -> None:
    shares = RecordShares(1000)

    def written(source: str) -> int:
        return sum(shares.admit(source, 1, 0) for _ in range(5000))

    assert written("flood") == SHARE * 1000
    assert written("anna") == 1000 - SHARE * 1000
    assert dict(shares.left_out()) == {"flood": 4250, "anna": 4750}
    assert shares.left_out() == []
    assert not shares.admit("flood", 1, NS_PER_S - 1)
    assert sum(shares.admit("flood", 1, NS_PER_S) for _ in range(5000)) == SHARE * 1000


def test_a_source_within_its_rate_lacks_no_record_and_a_larger_step_than_its_share_is_left_out() -> None:
    shares = RecordShares(100)
    assert all(shares.admit("anna", 1, number * NS_PER_S // 75) for number in range(1000))
    assert not shares.admit("anna", 76, 100 * NS_PER_S)
    assert shares.left_out() == [("anna", 76)]


@pytest.mark.virtual_time
async def test_modes_that_change_in_turns_and_what_is_rejected_overwrite_no_ring(folder: Path) -> None:
    robot = recorded(folder, limits={"leg_rate_hz": 2})
    for _ in range(2000):
        robot.put(LEG_3, b"{", source="flood")
        robot.conductor.recorder.mode(Mode.ESTOPPED)
        robot.conductor.recorder.mode(Mode.IDLE)
    await asyncio.sleep(1)
    beat(robot)
    assert 0 < len([each for each in contents(folder, rec.Noted) if each.what == "mode"]) < 200
    assert 0 < len([each for each in contents(folder, rec.Noted) if each.what == "rejected"]) < 200
    assert "flood" in [each.source for each in contents(folder, rec.Noted) if each.what == "left_out"]
