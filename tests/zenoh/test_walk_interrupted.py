"""Ctrl-C and SIGTERM in a program of one's own that walks: the first has the robot sit down, the second stops it."""

import os
import signal
import sys

import pytest

from gateway.geometry import load
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import STILL
from gateway.people.walking.robot import Robot
from schemas.robot import JOINTS, LEGS
from schemas.telemetry import FrameRecord
from tests.support.child import Child
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, last_angles

gateway = gateway_fixture(patient(10_000, telemetry={"frames": True}))

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
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(walks())

asyncio.run(main())
"""
BY_HAND = ASYNC.replace("asyncio.run(main())", "asyncio.new_event_loop().run_until_complete(main())")
"""Nobody there handles Ctrl-C."""


def seat() -> dict[int, float]:
    """Where they are in a robot that lies on its belly with its feet on the ground, by the pure engine."""
    engine = Engine(Robot(load()))
    for wanted in (engine.stand, engine.sit):
        wanted()
        for _ in range(500):
            engine.step(STILL, 0.02)
    return {10 * leg + joint: angle for leg in LEGS for joint, angle in zip(JOINTS, engine.pose[leg], strict=True)}


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
    gateway: Gateway, number: signal.Signals, again: bool, program: str
) -> None:
    seated = seat()
    with gateway.client() as watcher:
        written = frames(watcher)
        child = Child([sys.executable, "-c", program.format(endpoint=gateway.endpoint)], os.environ)
        try:
            child.wait_for_output("it stands", 60)
            stood = last_angles(written.all)
            child.send_signal(number)
            if again:
                next(_ for _ in written.each() if _sits_down(written.all, stood, seated))  # not before: two may be one
                child.send_signal(number)
            code = child.wait(60)
        finally:
            child.close()
        assert code == {signal.SIGINT: -signal.SIGINT, signal.SIGTERM: 128 + signal.SIGTERM}[number], str(child)
        state = watcher.state()
        assert (state.mode, state.lease.holder) == ("idle", None)
        if again:
            assert last_angles(written.all) != pytest.approx(seated, abs=0.02)
        else:
            written.wait_for_all(lambda records: last_angles(records) == pytest.approx(seated, abs=0.02))


def _sits_down(records: list[FrameRecord], stood: dict[int, float], seated: dict[int, float]) -> bool:
    """Whether the body has sunk by a third: all six legs have bent, of which some stand in a walk."""
    now = last_angles(records)
    knees = [10 * leg + 2 for leg in LEGS]
    return all(abs(now[knee] - stood[knee]) > abs(seated[knee] - stood[knee]) / 3 for knee in knees)
