"""What the conductor learns besides commands: of the power board, of the controller, of others on the device."""

import asyncio
from pathlib import Path

import pytest

from gateway.errors import SpiError
from gateway.model.black_box import format as form
from gateway.model.frames import stop_leg
from gateway.robot.core.events import StoppedOutside
from gateway.robot.core.message import Verb
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode, Reason
from tests.support.elkapod import all_legs, elkapod
from tests.support.measured import MEASURED
from tests.support.power import FedRobot, running
from tests.support.robot import Robot, leg, started_and_quiet
from tests.unit.people.test_recorder import contents, recorded

pytestmark = pytest.mark.virtual_time

LEG_3 = keys.leg_command(3)
START = leg("start", 90, 90, 90)
UP_S = 1.0
"""The board switches eighteen servos on in three quarters of a second."""


# ---- the power board


async def test_a_landing_that_a_silent_board_begins_ends_in_time_though_nothing_else_happens() -> None:
    robot = FedRobot(watchdog={"timeout_ms": 10_000, "landing_ms": 500, "landing": {"31": 45}})
    await asyncio.sleep(UP_S)
    robot.put(LEG_3, START)
    await asyncio.sleep(UP_S)
    robot.line.hears = False
    await asyncio.sleep(0.15)
    assert robot.events(Kind.LANDING)
    await asyncio.sleep(0.5)
    assert running(robot) == []


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
        robot.conductor.look_outside()
    assert (robot.now_ns() - hangs_ns) / 1e9 < 0.5
    assert [what for _, what in robot.said] == ["shutdown"]


async def test_a_landing_that_a_tilt_begins_ends_in_time_though_no_measurement_follows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    watchdog = {"timeout_ms": 10_000, "landing_ms": 500, "landing": {"31": 45}}
    robot = await elkapod(safety={"max_tilt_deg": 30}, watchdog=watchdog)
    robot.put(keys.LEGS_COMMAND, all_legs("start", 90))
    await asyncio.sleep(0.1)
    monkeypatch.setattr(robot, "_go_on", lambda: None)
    await asyncio.sleep(0.021)
    for _ in range(2):
        robot.conductor.measured(MEASURED._replace(orientation_wxyz=(0.0, 1.0, 0.0, 0.0)), robot.now_ns())
        await asyncio.sleep(0.201)
    assert robot.events(Kind.LANDING)
    await asyncio.sleep(0.35)
    assert running(robot) == []


async def test_that_settings_were_changed_is_in_the_published_state_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet()
    monkeypatch.setattr(robot.controller, "put_right", lambda: "mode 3")
    robot.conductor.look_outside()
    assert [state.mode for state in robot.states] == [Mode.BUS_FAULT]


async def test_changed_settings_do_not_end_what_is_known_of_stop_servos(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet()
    found = ["mode 3"]
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.look_outside()
    monkeypatch.setattr(robot.controller, "put_right", lambda: found.pop() if found else None)
    robot.conductor.look_outside()
    assert not found
    assert robot.conductor.supervisor.stopped_outside
    await asyncio.sleep(0.1)
    assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED, "one of its Stops may still come"


@pytest.mark.parametrize("known", [None, False])
async def test_only_an_open_device_ends_what_is_known_of_stop_servos(
    monkeypatch: pytest.MonkeyPatch, known: bool | None
) -> None:
    robot = await started_and_quiet()
    at_work: list[bool | None] = [True]
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: at_work[0])
    robot.conductor.look_outside()
    at_work[0] = known
    robot.conductor.look_outside()
    assert robot.conductor.supervisor.stopped_outside is (known is None)
    assert robot.ask(LEG_3, START).reason is (Reason.SERVO_STOPPED if known is None else None)


async def test_after_a_bus_fault_no_start_is_taken_while_stop_servos_is_at_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = await started_and_quiet()
    at_work = True
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: at_work)
    robot.conductor.look_outside()
    robot.conductor.bus_failed(SpiError("unplugged"))
    robot.conductor.look_outside()  # the device is closed
    assert robot.conductor.supervisor.stopped_outside
    await asyncio.sleep(0.01)
    assert robot.mode == Mode.IDLE
    assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED
    at_work = False
    robot.conductor.look_outside()
    assert robot.ask(LEG_3, START).accepted


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


async def test_a_silent_controller_of_elkapod_ends_nothing_that_is_known_of_stop_servos() -> None:
    robot = await elkapod()
    robot.conductor._step(StoppedOutside(at_work=True))
    robot.conductor.bus.close()
    robot.conductor.look_outside()
    assert robot.conductor.supervisor.stopped_outside


async def test_stops_for_stop_servos_are_repeated_though_nothing_else_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet(rules={"repeats": 2})
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.look_outside()
    await asyncio.sleep(0.2)
    assert [frame for _, frame in robot.frames] == [stop_leg(number) for number in LEGS] * 3


# ---- what is known later


async def test_lost_stops_that_cannot_be_written_are_reported_for_their_key() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    robot.controller.fail_where(lambda _: True)
    robot.put(LEG_3, verb=Verb.LOST)
    (event,) = robot.events(Kind.COMMAND_REJECTED)
    assert (event.key, event.legs, event.reason) == (LEG_3, (3,), Reason.BUS_FAULT)


async def test_the_black_box_tells_lost_stops_from_what_was_rejected_unread(folder: Path) -> None:
    robot = recorded(folder)
    robot.put(LEG_3, START)
    robot.put(LEG_3, verb=Verb.LOST)
    numbers = [record.number for record in contents(folder, form.FrameWritten) if record.cause == "command"]
    assert len(numbers) == 2
    assert all(numbers)
