"""What the conductor learns besides commands: of the power board, of the controller, of others on the device."""

import asyncio
from pathlib import Path

import pytest

from gateway.errors import SpiError
from gateway.model.black_box import format as form
from gateway.model.frames import stop_leg
from gateway.robot.core.message import Verb
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode, Reason
from tests.support.elkapod import elkapod
from tests.support.power import FedRobot
from tests.support.robot import Robot, leg, started_and_quiet
from tests.unit.people.test_recorder import contents, recorded

pytestmark = pytest.mark.virtual_time

LEG_3 = keys.leg_command(3)
START = leg("start", 90, 90, 90)
UP_S = 1.0
"""The board switches eighteen servos on in three quarters of a second."""


# ---- the power board


async def test_what_comes_after_the_end_changes_nothing() -> None:
    robot = FedRobot()
    await asyncio.sleep(UP_S)
    assert not robot.conductor.closed, "so that frames of elkapod-2025 go on"
    robot.conductor.close()
    assert robot.conductor.closed
    robot.reports.clear()
    robot.conductor.power_changed()
    robot.conductor.bus_failed(SpiError("timed out"))
    assert robot.reports == []
    assert robot.mode == Mode.IDLE


# ---- the controller, and the device


async def test_a_controller_is_found_silent_though_a_transfer_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await elkapod()
    monkeypatch.setattr(robot, "_go_on", lambda: None)
    hangs_ns = robot.now_ns()
    while not robot.events(Kind.CONTROLLER_SILENT):
        await asyncio.sleep(0.1)  # as the beat does
        assert not robot.said
        robot.conductor.check_outside()
    assert (robot.now_ns() - hangs_ns) / 1e9 < 0.5
    assert [what for _, what in robot.said] == ["shutdown"]


async def test_that_settings_were_changed_is_in_the_published_state_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet()
    monkeypatch.setattr(robot.controller, "put_right", lambda: "mode 3")
    robot.conductor.check_outside()
    assert [state.mode for state in robot.states] == [Mode.BUS_FAULT]


async def test_stop_servos_that_began_during_a_bus_fault_is_found_before_a_command_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = await started_and_quiet()
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.bus_failed(SpiError("unplugged"))
    await asyncio.sleep(0.01)
    assert robot.mode == Mode.IDLE
    assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED
    kinds = [event.kind for event in robot.events()]
    assert kinds.count(Kind.STOPPED_OUTSIDE) == 1
    assert kinds.index(Kind.STOPPED_OUTSIDE) < kinds.index(Kind.BUS_RECOVERED), "it is known before the bus is open"


async def test_stop_servos_at_work_at_the_start_is_found_before_a_command_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = Robot()
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.start()
    assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED


async def test_stops_for_stop_servos_are_repeated_though_nothing_else_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet(rules={"repeats": 2})
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.check_outside()
    await asyncio.sleep(0.2)
    assert [frame for _, frame in robot.frames] == [stop_leg(number) for number in LEGS] * 3


# ---- what is known later


async def test_the_black_box_tells_lost_stops_from_what_was_rejected_unread(folder: Path) -> None:
    robot = recorded(folder)
    robot.put(LEG_3, START)
    robot.put(LEG_3, verb=Verb.LOST)
    numbers = [record.number for record in contents(folder, form.FrameWritten) if record.cause == "command"]
    assert len(numbers) == 2
    assert all(numbers)
