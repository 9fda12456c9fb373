"""What of the servos' supply follows from settings, from the wire, and from the board's news: in virtual time."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Final

import pytest

from schemas import keys
from schemas.robot import SERVO_IDS
from tests.support.elkapod import all_legs
from tests.support.power import FedElkapod, FedRobot
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
