"""The emergency stop on disk: what a start makes of whatever it finds, and in which order it is written."""

import asyncio
import errno
import fcntl
import json
import os
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from gateway.errors import ConfigError
from gateway.files import durable
from gateway.robot import service
from gateway.robot.core.events import EmergencyStop
from gateway.robot.host.disk import StateFolder
from gateway.robot.runtime import estop_keeper
from gateway.robot.runtime.estop_keeper import (
    ESTOP_FILE,
    FLUSH_S,
    LAST_FILE,
    MAX_BYTES,
    MAX_NUMBER,
    PAUSE_S,
    EstopKeeper,
    KeptEstop,
    read,
    take_over,
    write,
)  # fmt: skip
from schemas import keys
from schemas.words import Kind, Mode
from tests.support import robot as robots
from tests.support.robot import Robot

SINCE = datetime(2026, 11, 26, 4, 30, tzinfo=UTC)
ENGAGED = KeptEstop(7, True, "anna", SINCE)
UNHEARD_OF = 10**9


def test_an_emergency_stop_that_was_left_is_gone_and_its_number_is_not(tmp_path: Path) -> None:
    assert read(tmp_path) == KeptEstop(0), "a first start has none"
    assert (tmp_path / LAST_FILE).read_text() == '{"number":0}'
    write(tmp_path, ENGAGED)
    write(tmp_path, KeptEstop(9))
    assert not (tmp_path / ESTOP_FILE).exists()
    assert read(tmp_path) == KeptEstop(9)
    write(tmp_path, ENGAGED._replace(source="a\ud800"))
    assert read(tmp_path) == ENGAGED._replace(number=9, source="a?"), "the greater number counts"


def a_file_in_its_place(folder: Path) -> None:
    folder.rmdir()
    folder.touch()


def holds(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / ESTOP_FILE).write_text(text)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "gone": Path.rmdir,
    "a file in its place": a_file_in_its_place,
    "half of it": holds('{"number":7,"sour'),
    "no number": holds('{"number":"7","source":null,"time":"2026-11-26T04:30:00Z"}'),
    "a number that cannot be counted on": holds('{"number":9007199254740991,"time":"2026-11-26T04:30:00Z"}'),
    "without a zone": holds('{"number":7,"source":null,"time":"2026-11-26T04:30:00"}'),
    "huge": holds(" " * (MAX_BYTES + 1)),
    "a folder": lambda folder: (folder / ESTOP_FILE).mkdir(),
    "a pipe": lambda folder: os.mkfifo(folder / ESTOP_FILE),
    # An earlier run could not keep one, either.
    "no space": lambda folder: durable.staged_for(folder / LAST_FILE).symlink_to("/dev/full"),
    "not writable": lambda folder: durable.staged_for(folder / LAST_FILE).mkdir(),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_where_it_cannot_be_told_one_is_engaged_with_a_new_number_and_the_place_is_named(
    tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    folder = tmp_path / "state"
    folder.mkdir()
    damage(folder)
    found, again = read(folder), read(folder)
    assert found.engaged
    assert found.time is not None
    assert str(folder) in str(found.fault)
    assert UNHEARD_OF <= found.number != again.number


def test_a_damaged_last_number_is_replaced_by_one_that_nobody_has_heard_of(tmp_path: Path) -> None:
    (tmp_path / LAST_FILE).write_text("seven")
    found = read(tmp_path)
    assert (found.engaged, found.fault) == (False, None)
    assert found.number >= UNHEARD_OF
    assert read(tmp_path) == found, "it is kept"


@pytest.mark.parametrize(
    ("at", "what", "fault", "before", "after"),
    [
        (Path, "unlink", KeyboardInterrupt, ENGAGED, KeptEstop(7)),  # a crash before the file is removed
        (durable, "write", OSError(errno.ENOSPC, "No space", "last"), ENGAGED, KeptEstop(7)),
        (os, "fsync", KeyboardInterrupt, None, ENGAGED),  # a new file is there before it is synced
    ],
)
def test_a_write_that_is_interrupted_leaves_it_engaged(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    at: object,
    what: str,
    fault: Any,
    before: KeptEstop | None,
    after: KeptEstop,
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise fault

    if before is not None:
        write(tmp_path, before)
    monkeypatch.setattr(at, what, fail)
    with pytest.raises((KeyboardInterrupt, ConfigError)) as raised:
        write(tmp_path, after)
    assert not isinstance(fault, OSError) or "No space" in str(raised.value)
    monkeypatch.undo()
    assert read(tmp_path) == ENGAGED


def test_after_a_power_cut_the_disk_has_what_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is synced is there: a new file and its folder; after a reset, the folder without it."""
    synced: list[tuple[str, bool]] = []
    sync = os.fsync

    def note(descriptor: int) -> None:
        synced.append((Path(os.readlink(f"/proc/self/fd/{descriptor}")).name, (tmp_path / ESTOP_FILE).exists()))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    write(tmp_path, ENGAGED)
    assert synced == [(durable.staged_for(tmp_path / ESTOP_FILE).name, True), (tmp_path.name, True)]
    write(tmp_path, KeptEstop(7))
    assert synced[-1] == (tmp_path.name, False)


# ---- The emergency stop's way to the disk, with a real thread and a real folder


Kept = tuple[Robot, EstopKeeper]


def begun(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Kept:
    monkeypatch.setattr(estop_keeper, "READ_S", 60.0)  # a busy machine may take longer than 2 s
    monkeypatch.setattr(robots, "rules", lambda settings: replace(service.rules(settings), estop_kept=True))
    robot = Robot()
    robot.conductor.start()
    return robot, EstopKeeper(robot.conductor, StateFolder(folder), robot.loop)


@pytest.fixture
async def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Kept]:
    robot, keeper = begun(tmp_path, monkeypatch)
    assert robot.mode == Mode.ESTOPPED
    await keeper.known()
    assert robot.mode == Mode.IDLE
    yield robot, keeper
    robot.conductor.close()


def number_kept(folder: Path) -> int:
    path = folder / ESTOP_FILE
    text = ""  # the file is there before its text is
    with suppress(FileNotFoundError):
        text = path.read_text()
    return int(json.loads(text)["number"]) if text else 0


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(15):
        while not condition():  # noqa: ASYNC110  (a file has no event)
            await asyncio.sleep(0.001)


@pytest.mark.lengthy
async def test_a_disk_that_takes_it_again_ends_the_fault(kept: Kept, tmp_path: Path) -> None:
    robot, _ = kept
    (tmp_path / ESTOP_FILE).mkdir()
    robot.put(keys.ESTOP)
    await until(lambda: robot.conductor.reports.estop_fault is not None)
    (tmp_path / ESTOP_FILE).rmdir()
    await until(lambda: number_kept(tmp_path) == 1)
    await until(lambda: robot.conductor.reports.estop_fault is None)
    (event,) = robot.events(Kind.ESTOP_NOT_KEPT)
    assert str(event.detail).startswith("the emergency stop is not kept, so a restart may forget it: ")
    assert robot.states[-1].estop_fault is None


async def test_an_emergency_stop_that_is_kept_already_is_not_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, ENGAGED)
    robot, keeper = begun(tmp_path, monkeypatch)
    await keeper.known()
    assert (robot.mode, robot.conductor.supervisor.latch.number) == (Mode.ESTOPPED, ENGAGED.number)
    assert keeper._idle.is_set()
    keeper.announce_start()
    (event,) = robot.events(Kind.ESTOP_KEPT)
    assert str(event.detail).startswith(
        "emergency stop 7 of 2026-11-26 04:30:00 UTC, by anna is still engaged; make sure"
    )
    robot.conductor.close()


@pytest.mark.parametrize("earlier", [None, KeptEstop(7), ENGAGED])
async def test_an_emergency_stop_that_comes_while_the_disk_is_read_is_kept(
    earlier: KeptEstop | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The power board's off button needs no client."""
    if earlier is not None:
        write(tmp_path, earlier)
    robot, keeper = begun(tmp_path, monkeypatch)
    robot.put(keys.ESTOP, {"source": "button"})
    await keeper.known()
    await until(keeper._idle.is_set)
    robot.conductor.close()
    found = read(tmp_path)
    assert found[:3] == (1 + (earlier or KeptEstop(0)).number, True, "button")


async def test_beside_another_gateway_it_counts_as_engaged_and_removes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is engaged, but not by the other's number: what the other has is its own."""
    write(tmp_path, ENGAGED)
    other_gateway = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(other_gateway, fcntl.LOCK_EX)
    robot, keeper = begun(tmp_path, monkeypatch)
    await keeper.known()
    number = robot.conductor.supervisor.latch.number
    assert robot.mode == Mode.ESTOPPED
    assert number >= UNHEARD_OF
    assert "another gateway" in str(robot.conductor.reports.estop_fault)
    os.close(other_gateway)  # it ends without a reset
    robot.put(keys.RESET, {"estop": number})
    await until(lambda: bool(robot.events(Kind.ESTOP_NOT_KEPT)))
    assert robot.mode == Mode.IDLE
    assert read(tmp_path) == ENGAGED
    robot.conductor.close()


async def test_requests_that_come_slower_than_the_disk_writes_wait_for_their_turn_too(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, keeper = kept
    write = estop_keeper.write
    begun_s, ended_s = list[float](), list[float]()

    def timed(folder: Path, estop: KeptEstop) -> None:
        begun_s.append(time.monotonic())
        write(folder, estop)
        ended_s.append(time.monotonic())

    monkeypatch.setattr(estop_keeper, "write", timed)
    for number in (1, 2):
        robot.put(keys.ESTOP)
        await until(lambda number=number: number_kept(tmp_path) == number)  # type: ignore[misc]
        await until(keeper._idle.is_set)
    assert begun_s[1] - ended_s[0] >= 0.9 * PAUSE_S


async def test_the_answer_states_whether_the_disk_has_it(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, keeper = kept
    answers = robot.get(keys.ESTOP)
    await until(lambda: bool(answers))
    assert (answers[0].estop, answers[0].kept, read(tmp_path).number) == (1, True, 1)
    goes_on = threading.Event()

    def hold(folder: Path, estop: KeptEstop) -> None:
        goes_on.wait(15)
        write(folder, estop)

    monkeypatch.setattr(estop_keeper, "write", hold)
    robot.put(keys.RESET, {"estop": 1})
    late = robot.get(keys.ESTOP)
    await until(lambda: bool(late))
    assert (late[0].estop, late[0].kept) == (2, False), "the disk still has the reset to write"
    at_the_end = robot.get(keys.ESTOP)
    ending = asyncio.create_task(asyncio.to_thread(keeper.flush))
    await until(lambda: bool(at_the_end))
    goes_on.set()
    await ending
    await until(lambda: number_kept(tmp_path) == 3)


async def test_without_a_state_folder_the_answer_states_nothing_about_a_disk() -> None:
    robot = Robot()
    robot.conductor.start()
    assert robot.ask(keys.ESTOP).kept is None


async def test_the_greatest_number_that_a_file_may_have_is_counted_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, ENGAGED._replace(number=MAX_NUMBER - 1))
    robot, keeper = begun(tmp_path, monkeypatch)
    await keeper.known()
    robot.put(keys.ESTOP)
    answers = robot.get(keys.ESTOP)
    await until(lambda: number_kept(tmp_path) == MAX_NUMBER + 1 and bool(answers))
    robot.conductor.close()
    assert read(tmp_path).engaged, "as a damaged file"
    assert answers[0].estop == MAX_NUMBER + 1


@pytest.mark.parametrize("engaged", [True, False])
@pytest.mark.parametrize("folder", [True, False])
async def test_what_this_process_hands_over_to_itself_is_newer_than_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engaged: bool, folder: bool
) -> None:
    """No disk keeps it, or the disk was too slow."""
    write(tmp_path, KeptEstop(0) if engaged else KeptEstop(1, True, "anna", SINCE))
    robot = Robot()
    robot.conductor.start()
    robot.put(keys.ESTOP, {"source": "anna"})
    if not engaged:
        await asyncio.sleep(0.001)
        robot.put(keys.RESET, {"estop": 1})
    for name, text in EstopKeeper(robot.conductor, None, robot.loop).hand_over().items():
        monkeypatch.setenv(name, text)
    monkeypatch.setattr(robots, "rules", lambda settings: replace(service.rules(settings), estop_kept=True))
    again = Robot()
    again.conductor.start()
    state = StateFolder(tmp_path) if folder else None
    keeper = EstopKeeper(again.conductor, state, again.loop, take_over())
    await keeper.known()
    assert again.mode == (Mode.ESTOPPED if engaged else Mode.IDLE)
    assert (again.conductor.supervisor.latch.number, take_over()) == (1, None)
    assert again.state().estop_source == ("anna" if engaged else None)
    if folder:
        await until(keeper._idle.is_set)
        assert read(tmp_path)[:2] == (1, engaged)
    again.conductor.close()


@pytest.mark.parametrize("reset", [True, False], ids=["a reset", "the end of the service"])
async def test_neither_a_reset_nor_the_end_waits_for_the_pause_between_two_writes(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reset: bool
) -> None:
    robot, keeper = kept
    begun, goes_on = threading.Event(), threading.Event()

    def hold(folder: Path, estop: KeptEstop) -> None:
        begun.set()
        goes_on.wait(15)
        write(folder, estop)

    monkeypatch.setattr(estop_keeper, "write", hold)
    monkeypatch.setattr(estop_keeper, "PAUSE_S", 60.0)
    robot.put(keys.ESTOP)
    await until(begun.is_set)
    robot.put(keys.ESTOP)
    if reset:
        robot.put(keys.RESET, {"estop": 2})
    goes_on.set()
    if reset:
        await until(keeper._idle.is_set)
        assert json.loads((tmp_path / LAST_FILE).read_text()) == {"number": 2}
    else:
        await asyncio.to_thread(keeper.flush)
    assert number_kept(tmp_path) == (0 if reset else 2)


@pytest.mark.parametrize("begun", [False, True], ids=["before its step", "in its step"])
@pytest.mark.parametrize("reset", [False, True], ids=["", "while a reset is written"])
async def test_an_emergency_stop_delayed_by_a_hanging_transfer_is_kept(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bool, reset: bool
) -> None:
    """systemd kills the gateway then, and the next run has to start engaged. So does a mistake in its step end it."""
    robot, keeper = kept
    writes = threading.Event()
    if reset:
        robot.put(keys.ESTOP)
        await until(keeper._idle.is_set)
        monkeypatch.setattr(durable, "sync", lambda _: writes.wait(15))
        robot.put(keys.RESET, {"estop": 1})
    with robot.conductor.owner:
        if begun:
            robot.conductor.supervisor.step(EmergencyStop(), robot.now_ns())
        else:
            robot.put_later(keys.ESTOP)
            assert list(robot.take()) == []
        keeper.received()
        writes.set()
        ends_s = time.monotonic() + 15
        while number_kept(tmp_path) != 1 + reset:
            assert time.monotonic() < ends_s
            time.sleep(0.001)  # noqa: ASYNC251  (the loop waits for the state, too)


async def test_the_end_does_not_wait_for_a_disk_that_hangs(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, keeper = kept
    hangs = threading.Event()
    monkeypatch.setattr(estop_keeper, "write", lambda *_: hangs.wait())
    robot.put(keys.ESTOP)
    ending = threading.Thread(target=keeper.flush, daemon=True)
    ending.start()
    await asyncio.to_thread(ending.join, 50 * FLUSH_S)
    hangs.set()
    assert not ending.is_alive()
    assert number_kept(tmp_path) == 0
