"""What of the servos' supply follows from settings, from the wire, and from the board's news: in virtual time."""

import asyncio
from typing import Any, Final

import pytest

from gateway.robot.core.power import CutOn
from gateway.robot.power.board import News
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
UP_S: Final = 1.0
"""The board switches eighteen servos on in three quarters of a second."""


async def fed(**sections: dict[str, Any]) -> FedRobot:
    """A robot of hexapod-1.0 whose servos are all fed."""
    robot = FedRobot(watchdog={"timeout_ms": 10_000, **sections.pop("watchdog", {})}, **sections)
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
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


async def test_where_supply_is_a_servos_start_a_bus_at_fault_takes_it_whatever_is_configured() -> None:
    robot = await elkapod_runs(power={"cut_on": []})
    robot.elkapod.spi_fails = True
    await asyncio.sleep(0.021)
    assert robot.line.fed == NONE


async def test_where_the_controller_starts_servos_a_bus_at_fault_takes_no_supply_unless_configured() -> None:
    robot = await fed(power={"cut_on": []})
    robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
    robot.controller.fail_where(lambda _: True)
    robot.put(keys.leg_command(3), leg("stop"))
    await asyncio.sleep(0.1)
    assert robot.line.fed == ALL


async def test_an_emergency_stop_that_waits_for_the_state_takes_it_by_the_wire_or_the_setting() -> None:
    one = await elkapod_runs(power={"cut_on": []})
    supply_of(one).cut_early(CutOn.ESTOP)
    assert one.line.fed == NONE
    other = await fed(power={"cut_on": ["shutdown"]})
    supply_of(other).cut_early(CutOn.ESTOP)
    assert other.line.fed == ALL
    supply_of(other).cut_early(CutOn.SHUTDOWN)
    assert other.line.fed == NONE


async def test_a_supply_that_is_off_already_is_not_reported_as_taken() -> None:
    robot = await fed()
    robot.put(keys.ESTOP)
    await asyncio.sleep(0.1)
    robot.conductor.shut_down()
    assert [event.detail for event in robot.events(Kind.POWER_CUT)] == [
        "the servos' supply is taken, for the emergency stop"
    ]


async def test_a_stop_that_leaves_the_supply_on_is_answered_once() -> None:
    robot = await fed()
    robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
    answers = robot.get(keys.leg_command(3), leg("stop"))
    await asyncio.sleep(0.5)
    assert [ack.confirmed for ack in answers] == [False]


async def test_who_waits_for_all_is_answered_once_all_are_off() -> None:
    robot = await fed()
    told: list[bool] = []
    robot.put(keys.ESTOP)
    supply_of(robot).confirm_all(robot.now_ns(), lambda confirmed, _ms: told.append(confirmed))
    assert told == []
    await asyncio.sleep(0.14)
    assert told == [True]


# ---- what is known


async def test_a_servo_may_settle_for_as_long_as_is_configured() -> None:
    robot = await fed(power={"idle_ma": 100, "settle_ms": 1000})
    robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
    robot.line.simulated.draws_ma[SERVO_IDS.index(31)] = 500.0
    await asyncio.sleep(0.3)
    robot.put(keys.leg_command(3), leg("stop"))
    await asyncio.sleep(0.95)
    assert not robot.events(Kind.SERVO_DRAWS)
    await asyncio.sleep(0.4)
    assert robot.events(Kind.SERVO_DRAWS)


async def test_the_age_of_the_boards_last_answer_is_in_ms() -> None:
    robot = await fed()
    robot.line.unplugged = True
    await asyncio.sleep(0.05)
    report = robot.conductor.power_report()
    assert report is not None
    assert report.age_ms == pytest.approx(50, abs=12)


async def test_a_silence_that_ends_while_the_robot_lands_needs_no_reset() -> None:
    robot = await fed(watchdog={"landing_ms": 500, "landing": {"31": 45}})
    robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
    robot.line.hears = False
    await asyncio.sleep(0.2)
    assert robot.events(Kind.LANDING)
    robot.line.hears = True
    await asyncio.sleep(0.5 + UP_S)
    assert running(robot) == []
    assert robot.line.fed == ALL


async def test_with_elkapod_2025_supply_that_is_back_is_no_event_and_the_news_behind_it_are() -> None:
    robot = await elkapod_runs()
    robot.line._news += [News(Kind.POWER_RESTORED, "fed again"), News(Kind.POWER_FAULT, "too hot", frozenset({31}))]
    seen = supply_of(robot).look()
    assert [(each.kind, each.detail, each.legs) for each in seen.announcements] == [(Kind.POWER_FAULT, "too hot", (3,))]


async def test_there_is_news_once_and_none_before_the_board_has_said_anything() -> None:
    robot = FedRobot()
    assert not supply_of(robot).judge_currents(robot.now_ns())
    await asyncio.sleep(UP_S)
    assert not supply_of(robot).judge_currents(robot.now_ns())
    supply_of(robot).reset()
    assert supply_of(robot).judge_currents(robot.now_ns())
    supply_of(robot).look()
    assert not supply_of(robot).judge_currents(robot.now_ns())
