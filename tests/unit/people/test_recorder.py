"""What the gateway records in its black box, and without one."""

import asyncio
import os
from contextlib import nullcontext
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest

from gateway.model.black_box import MISTAKE, RING_FILE
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import Framing, decode
from gateway.people.incidents import ring_reader as rec
from gateway.robot.blackbox import recorder as recording
from gateway.robot.blackbox import ring as rings
from gateway.robot.core.events import Announce
from gateway.robot.settings import Settings
from schemas import keys
from schemas.robot import LEGS
from schemas.words import Cause, Kind
from tests.support.robot import LEG_3, Robot, leg

pytestmark = pytest.mark.virtual_time

START = leg("start", 90, 45, 120, source="anna", sent_ms=0)


def recorded(folder: Path, **sections: Any) -> Robot:
    """Return a gateway with a black box, as the service makes it. Its start's repeats are still to come."""
    robot = Robot({"state": {"path": str(folder)}, **sections})
    robot.conductor.start()
    robot.conductor.recorder.open(nullcontext())
    robot.conductor.reports.announce_start()
    return robot


def contents(folder: Path, *types: type[rec.Content]) -> list[Any]:
    records = rec.read(folder / RING_FILE)
    return [record.content for record in records if not types or isinstance(record.content, types)]


async def test_what_was_in_force_is_known_after_any_time_and_across_runs(folder: Path) -> None:
    robot = recorded(folder, limits={"leg_rate_hz": 1})
    revisions = {}
    for revision in (1, 2):
        robot.conductor.recorder.calibration(RobotCalibration(revision, {31: ServoMapping(revision)}))
        await asyncio.sleep(1)
        revisions[robot.now_ns()] = revision
        await asyncio.sleep(1)
    records = rec.read(folder / RING_FILE)
    assert {ns: in_force(records, ns) for ns in revisions} == revisions
    for _ in range(80):  # the ring comes round
        await asyncio.sleep(1)
        for _ in range(100):
            robot.conductor.recorder.beat(1_000_000_000)
    assert 70 <= len(contents(folder, rec.WallTime)) <= 80, "one in a second"
    assert 10 <= len(contents(folder, rec.About)) <= 17, "one in five seconds"
    records = rec.read(folder / RING_FILE)
    assert records.times_ns[0] > max(revisions)
    assert (in_force(records, robot.now_ns()), in_force(records, min(revisions))) == (2, 2)
    assert records.about_at(robot.now_ns())["limits"]["leg_rate_hz"] == 1
    robot.conductor.recorder.close()
    after = recorded(folder, limits={"leg_rate_hz": 1})
    before_ns = after.now_ns()
    await asyncio.sleep(1)
    after.conductor.recorder.calibration(RobotCalibration())
    records = rec.read(folder / RING_FILE)
    assert [in_force(records, ns) for ns in (before_ns, after.now_ns())] == [2, 0]


def in_force(records: rec.Records, ns: int) -> int | None:
    """Return the calibration's revision in force at that time."""
    found = records.calibration_at(ns)
    return None if found is None else found.revision


async def test_a_run_that_fails_at_once_has_its_end(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as one whose port is taken: it fails before its black box is open."""
    recorder, begun, prepare = Robot({"state": {"path": str(folder)}}).conductor.recorder, Event(), rings.prepare
    ended = Event()

    def late(path: Path) -> Path:
        begun.set()
        assert ended.wait(60)
        return prepare(path)

    monkeypatch.setattr(rings, "prepare", late)
    monkeypatch.setattr(recording, "OPENING_S", 60)  # a busy machine may take longer than a robot
    Thread(target=recorder.open, args=(nullcontext(),), daemon=True).start()
    assert begun.wait(60)
    recorder.ended("the port is taken")
    ended.set()
    recorder.close()
    assert contents(folder)[-1] == rec.Noted("end", "the port is taken")


async def test_what_waits_or_is_rejected_has_its_outcome_too(folder: Path) -> None:
    robot = recorded(folder)
    for angle in (90, 91, 92):
        robot.put(LEG_3, leg("start", angle, angle, angle))
    robot.put(LEG_3, b"{")
    robot.put(LEG_3, leg("start", 1, 1, 1, source="slow", sent_ms=1))
    await asyncio.sleep(0.7)
    robot.put(LEG_3, leg("start", 1, 1, 1, source="slow", sent_ms=2))
    found = contents(folder, rec.CommandRecord, rec.StepRecord, rec.Noted)
    verdicts = [
        each
        for content in found
        for each in ([(content.what, content.detail)] if isinstance(content, rec.Noted) else content.ended)
        if each[0] != "mode"
    ]
    assert verdicts[-6:] == [
        (1, "accepted"),
        (2, "coalesced"),
        ("rejected", "malformed"),
        (3, "coalesced"),
        (4, "accepted"),
        (0, "stale"),
    ]
    last = contents(folder, rec.CommandRecord)[-1]
    assert (last.number, last.source, last.sent_ms) == (0, "slow", 2.0), "a stale one is decoded as well"


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("only_stops", [True, False])
async def test_nothing_is_recorded_before_a_frame_is_written(
    folder: Path, framing: Framing, only_stops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = recorded(folder, spi={"framing": framing})
    await asyncio.sleep(1)  # the repeats of the start's Stops, with their preambles
    there: list[list[Any]] = []
    monkeypatch.setattr(robot.controller, "transfer", lambda _: there.append(contents(folder)))
    before = len(contents(folder))
    robot.put(LEG_3, leg("stop") if only_stops else leg("start", 9, 9, 9))
    assert {len(found) for found in there} == {before}
    after = {type(found) for found in contents(folder)[before:]}
    assert after - {rec.Noted} == {rec.CommandRecord, rec.FrameWritten}


@pytest.mark.parametrize("framing", Framing)
async def test_a_setpoint_is_one_record(folder: Path, framing: Framing) -> None:
    robot = recorded(folder, spi={"framing": framing}, rules={"repeats": 0})
    robot.put(LEG_3, START)
    before = len(contents(folder))
    for angle in (0.01, 90, 180):
        await asyncio.sleep(0.1)
        robot.put(LEG_3, leg("set", angle, 46, 120, source="anna"), received_ns=robot.now_ns() - 3)
    left_out = rec.StepRecord | rec.WallTime
    records = [each for each in list(rec.read(folder / RING_FILE))[before:] if not isinstance(each.content, left_out)]
    assert [type(record.content) for record in records] == [rec.CommandRecord, rec.FrameWritten] * 3
    assert len({record.sequence for record in records}) == 3
    for command, frame in zip(records[::2], records[1::2], strict=True):
        assert isinstance(command.content, rec.CommandRecord)
        assert isinstance(frame.content, rec.FrameWritten)
        assert decode(frame.content.data).servos == command.content.targets
        assert frame.ns > command.ns
        assert frame.content.cause == Cause.COMMAND
        assert command.content.ended == ((command.content.number, "accepted"),)


@pytest.mark.parametrize("op", ["set", "stop"])
async def test_what_one_call_carries_out_is_one_record(folder: Path, op: str) -> None:
    def all_legs(op: str) -> dict[str, Any]:
        return {str(each): leg(op, *(() if op == "stop" else (80 + each, 45, 120))) for each in LEGS}

    robot = recorded(folder, rules={"repeats": 0})
    robot.put(keys.LEGS_COMMAND, {"legs": all_legs("start"), "source": "anna"})
    await asyncio.sleep(0.1)
    before = len(rec.read(folder / RING_FILE))
    robot.put(keys.LEGS_COMMAND, {"legs": all_legs(op), "source": "anna", "sent_ms": 5})
    records = [each for each in list(rec.read(folder / RING_FILE))[before:] if not isinstance(each.content, rec.Noted)]
    command = records[0].content
    assert isinstance(command, rec.CommandRecord)
    assert command.ended == ((command.number, "accepted"),)
    written = [(each, each.content.data) for each in records if isinstance(each.content, rec.FrameWritten)]
    assert sum((decode(data).servos for _, data in written), ()) == command.targets
    assert {each.sequence for each, _ in written} == {records[0].sequence}
    assert {each.ns for each, _ in written} == {robot.controller.transfers[-1][0]}


async def test_what_does_not_fit_into_one_record_has_two(folder: Path) -> None:
    robot = recorded(folder)
    await asyncio.sleep(6)
    before = len(contents(folder))
    long = leg("start", 90, 45, 120, source="ä" * 64)
    robot.put(LEG_3, long)
    robot.put(keys.servo_command(41), {"op": "start", "angle_deg": 12.34}, received_ns=0)
    robot.put(keys.leg_command(5), START, received_ns=robot.now_ns() - 5_000_000_000)
    found = [each for each in contents(folder)[before:] if not isinstance(each, rec.Noted | rec.StepRecord)]
    assert [type(each) for each in found] == [rec.CommandRecord, rec.FrameWritten] * 3
    assert found[0].source == "ä" * 64
    steps = contents(folder, rec.CommandRecord, rec.StepRecord)
    assert [each.ended for each in steps if each.ended] == [((number, "accepted"),) for number in (1, 2, 3)]


async def test_what_waited_and_is_carried_out_in_anothers_step_keeps_its_own_targets(folder: Path) -> None:
    robot = recorded(folder)
    leg_4 = keys.leg_command(4)
    robot.put(LEG_3, leg("start", 90, 90, 90))
    robot.put(LEG_3, leg("start", 91, 91, 91))
    robot.sleep_through(0.004)
    robot.put(leg_4, leg("start", 10, 10, 10))
    robot.sleep_through(0.0015)  # leg 3 has a rate slot again, a quarter of its period after the first; leg 4 has none
    robot.put(leg_4, leg("start", 11, 11, 11))
    commands = {each.number: each for each in contents(folder, rec.CommandRecord)}
    assert [(each.key, each.targets[0][1].angle_cdeg) for each in commands.values()] == [
        (LEG_3, 90_00), (LEG_3, 91_00), (leg_4, 10_00), (leg_4, 11_00),
    ]  # fmt: skip
    found = contents(folder, rec.CommandRecord, rec.StepRecord)
    accepted = [number for each in found for number, verdict in each.ended if verdict == "accepted"]
    assert accepted == [1, 3, 2]
    frames = [frame for frame in contents(folder, rec.FrameWritten) if frame.cause == Cause.COMMAND]
    assert [decode(frame.data).servos for frame in frames] == [commands[number].targets for number in accepted]


async def test_a_command_that_broke_the_gateway_is_there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = recorded(folder)
    monkeypatch.setattr(robot.controller, "transfer", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        robot.put(LEG_3, START)
    robot.conductor.recorder.mistake("a mistake in the gateway ended it")
    assert contents(folder, rec.CommandRecord)[-1].source == "anna"
    mistake = rec.EventPublished(MISTAKE, None, None, None, "a mistake in the gateway ended it", 0)
    assert contents(folder, rec.EventPublished)[-1] == mistake
    lefts = [Announce(kind, "", legs=legs) for kind in (Kind.BUTTON_SILENT, Kind.BUTTON_LEFT) for legs in ((), (1,))]
    incidents = [robot.conductor.recorder.event(each, None, 0) is not None for each in lefts]
    assert incidents == [False, True] * 2, "a button's end is one if legs stop"


@pytest.mark.parametrize("why", ["Not a directory", "No space left on device"])
async def test_without_a_ring_it_drives_all_the_same_and_says_so_once(
    folder: Path, why: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: int) -> None:
        raise OSError(28, why)

    monkeypatch.setattr(os, "posix_fallocate", full)
    if why == "Not a directory":
        os.rmdir(folder)
        os.mknod(folder)
    robot = recorded(folder)
    assert robot.ask(LEG_3, START).accepted
    await asyncio.sleep(1)
    expired, stopped = robot.events()[-2:]
    assert [expired.kind, stopped.kind] == [Kind.WATCHDOG_EXPIRED, Kind.LEGS_STOPPED]
    assert expired.incident is stopped.incident is None, "no incident that nobody can look at"
    assert robot.state().incident is None
    (said,) = (entry.message for entry in caplog.records if "black box" in entry.message)
    place = folder if why == "Not a directory" else folder.with_name(RING_FILE)
    assert said == f"the black box is off: {place}: {why}"


@pytest.mark.parametrize(("rate", "records"), [(50, 78_000), (10, 20_400), (1000, 500_000)])
def test_the_size_follows_from_the_rate(rate: float, records: int) -> None:
    settings = Settings.of({"limits": {"leg_rate_hz": rate}})
    assert rings.slots_for(settings) == records


def test_the_ring_is_in_memory_and_the_folder_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a disk, a write would wait for the disk, and a Stop with it."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "memory"))
    for name in ("memory", "one", "other"):
        (tmp_path / name).mkdir()
    one, other = rings.prepare(tmp_path / "one"), rings.prepare(tmp_path / "other")
    assert one != other
    assert one.parent == other.parent == tmp_path / "memory"
    assert (tmp_path / "one" / RING_FILE).readlink() == one
    assert rings.prepare(tmp_path / "one") == one
