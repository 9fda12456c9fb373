"""Another program changed the device's settings: what is published, what is stopped, and which Stops still leave."""

import asyncio

import pytest

from gateway.model.frames import stop_leg
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode, Reason
from tests.support.robot import Robot, leg, started_and_quiet

pytestmark = pytest.mark.virtual_time

LEG_3 = keys.leg_command(3)
START = leg("start", 90, 90, 90)
ALL_STOPS = [stop_leg(number) for number in LEGS]
CYCLE = [Kind.BUS_MEDDLED, Kind.BUS_FAULT, Kind.BUS_RECOVERED]


class Meddler:
    """Changes the settings of the robot's device when the test says so."""

    def __init__(self, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
        self.found: str | None = None
        monkeypatch.setattr(robot.controller, "put_right", self)

    def __call__(self) -> str | None:
        found, self.found = self.found, None
        return found


async def meddled(monkeypatch: pytest.MonkeyPatch, *running: str) -> tuple[Robot, Meddler]:
    """A robot of which these legs run, and which has not written for a while."""
    robot = await started_and_quiet(watchdog={"timeout_ms": 10_000}, rules={"repeats": 2})
    meddler = Meddler(robot, monkeypatch)
    for key in running:
        assert robot.ask(key, START).accepted
    await asyncio.sleep(0.5)
    robot.controller.transfers.clear()
    robot.reports.clear()
    meddler.found = "mode 3"
    return robot, meddler


def kinds(robot: Robot) -> list[Kind | str]:
    return [event.kind for event in robot.events() if event.kind is not Kind.COMMAND_REJECTED]


async def test_the_look_ten_times_a_second_publishes_it_and_stops_all_legs(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, _ = await meddled(monkeypatch, LEG_3)
    robot.conductor.check_outside()
    assert robot.mode == Mode.BUS_FAULT
    await asyncio.sleep(0.001)
    assert [frame for _, frame in robot.frames] == ALL_STOPS
    assert robot.controller.energised == set()
    assert [(event.kind, event.detail) for event in robot.events()][:2] == [
        (Kind.BUS_MEDDLED, "mode 3"),
        (Kind.BUS_FAULT, "mode 3"),
    ]
    assert kinds(robot) == CYCLE
    assert robot.ask(LEG_3, leg("set", 91, 91, 91)).reason is Reason.SERVO_STOPPED
    for _ in range(3):
        robot.conductor.check_outside()
    assert robot.ask(LEG_3, START).accepted
    assert kinds(robot) == CYCLE


async def test_at_the_end_the_stops_and_their_repeats_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, meddler = await meddled(monkeypatch, LEG_3)
    assert robot.conductor.shut_down()
    meddler.found = "mode 1"
    robot.conductor.check_outside()
    await asyncio.sleep(1)
    assert [frame for _, frame in robot.frames] == ALL_STOPS * 3
    assert robot.conductor.done.is_set()
    assert [event.detail for event in robot.events(Kind.BUS_MEDDLED)] == ["mode 3", "mode 1"]
    assert not robot.events(Kind.BUS_FAULT)
