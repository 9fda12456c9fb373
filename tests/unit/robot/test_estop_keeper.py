"""The emergency stop's way to the disk, with a real thread and a real folder."""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.robot import service
from gateway.robot.host import estop_file
from gateway.robot.host.estop_file import ESTOP_FILE, LAST_FILE, KeptEstop
from gateway.robot.runtime.estop_keeper import FLUSH_S, PAUSE_S, EstopKeeper
from schemas import keys
from schemas.telemetry import Kind, Mode
from tests.support import robot as robots
from tests.support.robot import Robot

Kept = tuple[Robot, EstopKeeper]


@pytest.fixture
async def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Kept]:
    monkeypatch.setattr(robots, "rules", lambda settings: replace(service.rules(settings), estop_kept=True))
    robot = Robot()
    robot.conductor.start()
    keeper = EstopKeeper(robot.conductor, tmp_path, robot.loop)
    assert robot.mode == Mode.ESTOPPED
    await keeper.known()
    assert robot.mode == Mode.IDLE
    yield robot, keeper
    robot.conductor.close()


def number_kept(folder: Path) -> int:
    path = folder / ESTOP_FILE
    return int(json.loads(path.read_text())["number"]) if path.exists() else 0


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(15):
        while not condition():  # noqa: ASYNC110  (a file has no event)
            await asyncio.sleep(0.001)


async def test_a_disk_that_takes_it_again_ends_the_fault(kept: Kept, tmp_path: Path) -> None:
    robot, _ = kept
    (tmp_path / ESTOP_FILE).mkdir()
    robot.put(keys.ESTOP)
    await until(lambda: robot.conductor.reports.estop_fault is not None)
    (tmp_path / ESTOP_FILE).rmdir()
    await until(lambda: number_kept(tmp_path) == 1)
    await until(lambda: robot.conductor.reports.estop_fault is None)
    assert len(robot.events(Kind.ESTOP_NOT_KEPT)) == 1
    assert robot.states[-1].estop_fault is None


async def test_requests_that_come_slower_than_the_disk_writes_wait_for_their_turn_too(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, keeper = kept
    write = estop_file.write
    begun_s, ended_s = list[float](), list[float]()

    def timed(folder: Path, estop: KeptEstop) -> None:
        begun_s.append(time.monotonic())
        write(folder, estop)
        ended_s.append(time.monotonic())

    monkeypatch.setattr(estop_file, "write", timed)
    for number in (1, 2):
        robot.put(keys.ESTOP)
        await until(lambda number=number: number_kept(tmp_path) == number)  # type: ignore[misc]
        await until(keeper._idle.is_set)
    assert begun_s[1] - ended_s[0] >= 0.9 * PAUSE_S


async def test_a_reset_waits_for_no_turn(kept: Kept, tmp_path: Path) -> None:
    robot, keeper = kept
    robot.put(keys.ESTOP)
    robot.put(keys.ESTOP)
    robot.put(keys.RESET, {"estop": 2})
    keeper.flush()
    assert not (tmp_path / ESTOP_FILE).exists()
    assert json.loads((tmp_path / LAST_FILE).read_text()) == {"number": 2}


async def test_the_end_does_not_wait_for_a_disk_that_hangs(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, keeper = kept
    hangs = threading.Event()
    monkeypatch.setattr(estop_file, "write", lambda *_: hangs.wait())
    robot.put(keys.ESTOP)
    ending = threading.Thread(target=keeper.flush, daemon=True)
    ending.start()
    await asyncio.to_thread(ending.join, 50 * FLUSH_S)
    hangs.set()
    assert not ending.is_alive()
    assert number_kept(tmp_path) == 0
