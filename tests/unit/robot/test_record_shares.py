"""How many records each source may make: a flood overwrites nothing that precedes an incident, and hides nobody."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from gateway.model.black_box import format as form
from gateway.robot.blackbox.recorder import SHARE, RecordShares
from schemas import keys
from schemas.telemetry import Cause
from tests.support.robot import Robot, leg, servo
from tests.unit.people.test_recorder import contents, recorded

A_SECOND: Final = 1000
HZ: Final = 50
LEG_1: Final = keys.leg_command(1)


def written(shares: RecordShares, source: str | None, count: int, now_ns: int) -> int:
    return sum(shares.admit(source, 1, now_ns) for _ in range(count))


def test_one_source_leaves_some_for_others_and_what_is_left_out_is_counted_once() -> None:
    shares = RecordShares(A_SECOND)
    assert written(shares, "flood", 5000, 0) == SHARE * A_SECOND
    assert written(shares, "anna", 5000, 0) == A_SECOND - SHARE * A_SECOND
    assert dict(shares.left_out()) == {"flood": 4250, "anna": 4750}
    assert shares.left_out() == []


def estops_and_resets(robot: Robot, number: int) -> None:
    robot.put(keys.ESTOP)
    reset = {"estop": robot.conductor.supervisor.latch.number, "source": f"source {number % 300}"}
    robot.put(keys.RESET, reset)


FLOODS: dict[str, tuple[int, Callable[[Robot, int], None]]] = {
    "emergency stops": (3000, lambda robot, number: robot.put(keys.ESTOP, {"source": f"source {number % 300}"})),
    "Stops of a servo": (18_000, lambda robot, _: robot.put(keys.servo_command(31), servo("stop"))),
    "emergency stops and resets": (2000, estops_and_resets),
    "rejected messages": (18_000, lambda robot, number: robot.put(LEG_1, {"source": f"source {number}"})),
}
"""How many messages, which made more records than the ring of these settings has slots."""


@pytest.mark.lengthy
@pytest.mark.virtual_time
@pytest.mark.parametrize("flood", FLOODS)
async def test_what_precedes_an_incident_is_still_there_after_a_flood(folder: Path, flood: str) -> None:
    robot = recorded(folder, limits={"leg_rate_hz": HZ})
    robot.put(keys.leg_command(3), leg("start", 90, 45, 120, source="anna"))
    for number in range(10):
        await asyncio.sleep(0.1)
        robot.put(keys.leg_command(3), leg("set", 90, 45, 100 + number, source="anna"))
    robot.put(keys.ESTOP, {"source": "bert"})
    count, send = FLOODS[flood]
    for number in range(count):
        send(robot, number)
        if number % (count // 6) == 0:
            robot.conductor.recorder.beat(0)
            await asyncio.sleep(1)
    commands = [each for each in contents(folder, form.CommandRecord) if each.source == "anna"]
    assert len(commands) == 11, "what precedes the incident"
    assert contents(folder, form.IncidentBegun)
    assert len([each for each in contents(folder, form.FrameWritten) if each.cause == Cause.ESTOP]) >= 6
    left_out = sum(each.count for each in contents(folder, form.LeftOut))
    assert left_out > 1000, "and the ring says how much it lacks"
