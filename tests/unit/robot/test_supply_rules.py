"""What of the servos' supply follows from settings, from the wire, and from the board's news: in virtual time."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Final

import pytest

from gateway.robot.runtime.supply import RobotSupply
from schemas import keys
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind
from tests.support.elkapod import all_legs
from tests.support.power import FedElkapod, FedRobot, running
from tests.support.robot import leg

pytestmark = pytest.mark.virtual_time

ALL: Final = frozenset(SERVO_IDS)
NONE: Final = frozenset[int]()
UP_S: Final = 1.2
"""The board switches eighteen servos on in three quarters of a second."""


async def runs(**sections: dict[str, Any]) -> FedRobot:
    """One of hexapod-1.0 of which leg 3 runs, and is fed."""
    robot = FedRobot(watchdog={"timeout_ms": 10_000, **sections.pop("watchdog", {})}, **sections)
    await asyncio.sleep(UP_S)
    robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
    await asyncio.sleep(UP_S)
    assert robot.line.fed == {31, 32, 33}
    return robot


async def elkapod_runs(**sections: dict[str, Any]) -> FedElkapod:
    """One of elkapod-2025, all of whose servos run and are fed."""
    robot = FedElkapod(watchdog={"timeout_ms": 10_000}, **sections)
    await asyncio.sleep(0.5)
    robot.put(keys.LEGS_COMMAND, all_legs("start", 90))
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
    return robot


def supply_of(robot: FedRobot | FedElkapod) -> RobotSupply:
    assert robot.conductor.supply is not None
    return robot.conductor.supply


# ---- what takes it, by the wire


@pytest.mark.parametrize("make", [runs, elkapod_runs])
async def test_a_bus_at_fault_takes_it(make: Callable[[], Awaitable[FedRobot | FedElkapod]]) -> None:
    robot = await make()
    if isinstance(robot, FedElkapod):
        robot.elkapod.spi_fails = True
    else:
        robot.controller.fail_where(lambda _: True)
        robot.put(keys.leg_command(3), leg("set", 91, 91, 91))
    await asyncio.sleep(0.021)
    assert robot.line.fed == NONE


@pytest.mark.parametrize("make", [runs, elkapod_runs])
async def test_an_emergency_stop_that_waits_for_the_state_takes_it(
    make: Callable[[], Awaitable[FedRobot | FedElkapod]],
) -> None:
    robot = await make()
    supply_of(robot).cut_early()
    assert robot.line.fed == NONE


async def test_a_supply_that_is_off_already_is_not_reported_as_taken() -> None:
    robot = await runs()
    robot.put(keys.ESTOP)
    await asyncio.sleep(0.1)
    robot.conductor.shut_down()
    assert [event.detail for event in robot.events(Kind.POWER_CUT)] == [
        "the servos' supply is taken, for the emergency stop"
    ]


async def test_a_stop_is_answered_once_also_where_a_start_follows_at_once() -> None:
    robot = await runs()
    answers = robot.get(keys.leg_command(3), leg("stop"))
    robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
    await asyncio.sleep(0.6)
    assert len(answers) == 1


async def test_who_waits_for_all_is_answered_once_all_are_off() -> None:
    robot = await runs()
    told: list[bool] = []
    robot.put(keys.ESTOP)
    supply_of(robot).confirm(SERVO_IDS, robot.now_ns(), lambda confirmed, _ms: told.append(confirmed))
    assert told == []
    await asyncio.sleep(0.14)
    assert told == [True]


# ---- what is known


async def test_the_age_of_the_boards_last_answer_is_in_ms() -> None:
    robot = await runs()
    robot.line.unplugged = True
    await asyncio.sleep(0.05)
    report = robot.conductor.power_report()
    assert report is not None
    assert report.age_ms == pytest.approx(50, abs=12)


async def test_a_silence_that_ends_while_the_robot_lands_needs_no_reset() -> None:
    robot = await runs(watchdog={"timeout_ms": 3000, "landing_ms": 500, "landing": {"31": 45}})
    robot.line.hears = False
    await asyncio.sleep(0.2)
    assert robot.events(Kind.LANDING)
    robot.line.hears = True
    await asyncio.sleep(0.5 + UP_S)
    assert running(robot) == []
    answers = robot.get(keys.leg_command(3), leg("start", 90, 90, 90))
    await asyncio.sleep(0.6)
    assert [ack.accepted for ack in answers] == [True]


async def test_there_is_news_once_and_none_before_the_board_has_said_anything() -> None:
    robot = FedRobot()
    assert not supply_of(robot).judge_currents(robot.now_ns())
    await asyncio.sleep(UP_S)
    assert not supply_of(robot).judge_currents(robot.now_ns())
    supply_of(robot).reset()
    assert supply_of(robot).judge_currents(robot.now_ns())
    supply_of(robot).look()
    assert not supply_of(robot).judge_currents(robot.now_ns())
