"""Walking through a real gateway: what it sends, how a walk ends, what Ctrl-C does, and a leg that is stopped."""

import os
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Final

import pytest

from gateway.client import Client, Walk
from gateway.errors import LeaseError, LeaseLostError, StoppedError
from gateway.geometry import load
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import STILL, Posture
from gateway.people.walking.robot import Robot
from schemas.event import FrameRecord
from schemas.robot import JOINTS, LEGS
from schemas.words import Kind, Mode
from tests.support.child import Child
from tests.support.cut_link import CutLink
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, last_angles, running

PATIENT: Final = patient(10_000, telemetry={"frames": True})
QUICKER: Final = 4
"""Ticks are 80 ms of a walk's time then, and a tick may be 100 (gateway/people/walking/engine.py)."""

gateway = gateway_fixture(PATIENT)

watcher = client_fixture("watcher", rests=True)
robot = client_fixture("walker")


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walk's own clock is quicker than the gateway's: as many ticks a second, and each goes further.

    Its patience with its program stays the same, for a machine that is busy.
    """
    quick = SimpleNamespace(monotonic=lambda: QUICKER * time.monotonic(), sleep=lambda s: time.sleep(s / QUICKER))
    monkeypatch.setattr("gateway.people.client.walk.time", quick)


def is_now(walk: Walk, posture: Posture) -> bool:
    return walk.state.posture is posture


def walks(walk: Walk, steps: int = 15, forward_m_s: float = 0.1) -> None:
    for _ in range(steps):
        walk.go(forward_m_s=forward_m_s)


def test_a_dozen_lines_stand_walk_turn_and_sit(robot: Client, watcher: Client) -> None:
    written = frames(watcher)
    before = watcher.state().commands
    with robot.walk() as walk:
        assert is_now(walk, Posture.LYING)
        assert not running(watcher)
        assert watcher.state().lease.holder == "walker"
        walk.stand(height_m=0.14)
        assert running(watcher) == [1, 2, 3, 4, 5, 6]
        assert is_now(walk, Posture.STANDING)
        assert walk.state.height_m == pytest.approx(0.14)
        for _ in range(30):
            walk.go(forward_m_s=0.07, turn_rad_s=0.15)
        state = walk.state
        assert state.posture is Posture.WALKING
        assert state.commanded == state.scaled == (0.07, 0.0, 0.15)
        assert state.odometry.x_m > 0.06
        assert state.odometry.heading_rad > 0.1
        walk.sit()
        assert is_now(walk, Posture.SITTING)
    after = watcher.state()
    assert after.mode == Mode.IDLE
    assert after.lease.holder is None
    assert after.commands.rejected == before.rejected
    assert [*last_angles(written.all)] == [10 * leg + joint for leg in LEGS for joint in JOINTS], "leg after leg"
    with pytest.raises(RuntimeError, match="this walk is closed"):
        walk.go(0.1)


def test_after_stops_of_others_it_goes_on_as_the_robot_then_is_and_an_error_of_the_program_stops_it(
    robot: Client, watcher: Client
) -> None:
    """What follows from which Stop: tests/unit/people/test_ride.py. Here the thread asks, starts and ends."""

    def program(walk: Walk) -> None:
        walk.stand()
        walks(walk, 10)
        assert watcher.stop(3).accepted
        with pytest.raises(StoppedError, match="watcher stopped leg 3, ") as error:
            walks(walk, 500)
        assert error.value.legs == (3,)
        assert running(watcher) == [1, 2, 4, 5, 6]
        assert (is_now(walk, Posture.HALTED), walk.state.lost) == (True, (3,))
        assert walk.now == "Leg 3 is stopped, and the others stand still"
        walk.start_again()
        walk.stand()
        assert running(watcher) == [1, 2, 3, 4, 5, 6]
        with watcher.lease(take=True):
            with pytest.raises(LeaseLostError, match="watcher"):
                walks(walk, 500)
            with pytest.raises(LeaseError, match="held by watcher"):
                walk.start_again()
            with pytest.raises(LeaseLostError, match="watcher"):
                walk.stand()
            assert not running(watcher)
        walk.start_again()
        assert not running(watcher)
        assert is_now(walk, Posture.LYING)
        walk.stand()
        assert watcher.state().lease.holder == "walker"
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), robot.walk() as walk:
        program(walk)
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None


# ---- Ctrl-C and SIGTERM in a program of one's own: the first has the robot sit down, the second stops it

BLOCKING = """
from gateway.client import Client

with Client("{endpoint}") as robot, robot.walk() as walk:
    walk.stand()
    print("it stands", flush=True)
    while True:
        walk.go(forward_m_s=0.05)
"""
ASYNC = """
import asyncio
from gateway.client import AsyncClient

async def walks():
    async with AsyncClient("{endpoint}") as robot, robot.walk() as walk:
        await walk.stand()
        print("it stands", flush=True)
        await walk.ahead(10)

async def main():
    walk = asyncio.create_task(walks())
    try:
        await asyncio.wait([walk])
    finally:
        for _ in range(2):  # as a task group may whose own task is cancelled, too
            walk.cancel()
            await asyncio.sleep(0.05)
        await walk

asyncio.run(main())
"""
BY_HAND = ASYNC.replace("asyncio.run(main())", "asyncio.new_event_loop().run_until_complete(main())")
"""Nobody there handles Ctrl-C."""


def poses() -> tuple[dict[int, float], dict[int, float]]:
    """Return the servos' angles in a robot that stands, and in one that sits on its belly, by the pure engine."""
    engine, found = Engine(Robot(load())), []
    for wanted in (engine.stand, engine.sit):
        wanted()
        for _ in range(500):
            engine.step(STILL, 0.02)
        found.append({10 * leg + joint: at for leg in LEGS for joint, at in zip(JOINTS, engine.pose[leg], strict=True)})
    stood, seated = found
    return stood, seated


def test_a_program_that_exits_does_not_drop_the_robot(robot: Client, watcher: Client) -> None:
    written = frames(watcher)

    def exits() -> None:
        with robot.walk() as walk:
            walk.stand()
            sys.exit()

    with pytest.raises(SystemExit):
        exits()
    _, seated = poses()
    written.wait_for_all(lambda records: last_angles(records) == pytest.approx(seated, abs=0.02))
    assert watcher.state().mode == Mode.IDLE


@pytest.mark.full
@pytest.mark.parametrize(
    ("program", "number", "again"),
    [
        pytest.param(BLOCKING, signal.SIGINT, True, id="blocking-Ctrl-C-twice"),
        pytest.param(BLOCKING, signal.SIGTERM, False, id="blocking-SIGTERM"),
        pytest.param(ASYNC, signal.SIGINT, False, id="async-Ctrl-C"),
        pytest.param(ASYNC, signal.SIGTERM, True, id="async-SIGTERM-twice"),
        pytest.param(BY_HAND, signal.SIGINT, False, id="by hand-Ctrl-C"),
    ],
)
def test_the_first_sits_and_the_second_stops(
    gateway: Gateway, watcher: Client, number: signal.Signals, again: bool, program: str
) -> None:
    stood, seated = poses()  # the frames up to now may be late: a lower pose than the last one has bent knees at once
    written = frames(watcher)
    with Child([sys.executable, "-c", program.format(endpoint=gateway.endpoint)], os.environ) as child:
        child.wait_for_output("it stands", 60)
        child.send_signal(number)
        if again:
            next(_ for _ in written.each() if _sits_down(written.all, stood, seated))  # not before: two may be one
            child.send_signal(number)
        code = child.wait(60)
    assert code == {signal.SIGINT: -signal.SIGINT, signal.SIGTERM: 128 + signal.SIGTERM}[number], str(child)
    state = watcher.state()
    assert (state.mode, state.lease.holder) == ("idle", None)
    if again:
        assert last_angles(written.all) != pytest.approx(seated, abs=0.02)
    else:
        written.wait_for_all(lambda records: last_angles(records) == pytest.approx(seated, abs=0.02))


def _sits_down(records: list[FrameRecord], stood: dict[int, float], seated: dict[int, float]) -> bool:
    """Return whether the body has sunk by a third: all six legs have bent, of which some stand in a walk."""
    now = last_angles(records)
    knees = [10 * leg + 2 for leg in LEGS]
    return all(abs(now[knee] - stood[knee]) > abs(seated[knee] - stood[knee]) / 3 for knee in knees)


WATCHDOG_MS = 1500
DELAY_S = 0.3
"""In each direction. A client that asks twice before it goes on is silent for longer than the watchdog waits."""


def test_the_other_legs_of_a_walk_keep_running(tmp_path: Path) -> None:
    with (
        Gateway(tmp_path, patient(WATCHDOG_MS)) as gateway,
        CutLink(gateway.endpoint, DELAY_S) as link,
        Client(gateway.endpoint, source="watcher") as watcher,
        Client(link.endpoint, source="walker", timeout_s=10) as robot,
        robot.walk() as walk,
    ):
        happened = events(watcher)
        walk.stand()
        watcher.stop(3)
        with pytest.raises(StoppedError, match="watcher stopped leg 3") as stopped:
            walks(walk, 10_000, forward_m_s=0.03)
        assert stopped.value.legs == (3,)
        answered = robot.state(), robot.state()  # twice the way there and back, longer than the watchdog's timeout
        assert [leg.leg for leg in answered[-1].legs if leg.running] == [1, 2, 4, 5, 6]
        assert running(watcher) == [1, 2, 4, 5, 6]
        assert Kind.WATCHDOG_EXPIRED not in [event.kind for event in happened.all]
