"""How many Python calls lie between a message and the device: what is added shows here (docs/design.md, *How fast*)."""

import asyncio
import sys
from types import FrameType

import pytest

from schemas import keys
from tests.support.robot import Robot, leg, started_and_quiet

_ALL = {"legs": {str(number): leg("start", 90, 45, 120) for number in range(1, 7)}}


def calls_to_the_device(robot: Robot, key: str, payload: object) -> int:
    """Calls from a message to the device's first transfer that it causes."""
    calls: list[str] = []

    def note(frame: FrameType, event: str, _arg: object) -> None:
        if event == "call":
            calls.append(frame.f_code.co_qualname)

    sys.setprofile(note)
    try:
        robot.put(key, payload)
    finally:
        sys.setprofile(None)
    begin = next(place for place, name in enumerate(calls) if name == "Conductor.tick")
    return next(place for place, name in enumerate(calls) if name == "ByteDevice.transfer") - begin


@pytest.mark.virtual_time
@pytest.mark.parametrize(
    ("key", "payload", "most"),
    [
        pytest.param(keys.ESTOP, {}, 120, id="an emergency stop while a leg runs"),
        pytest.param(keys.leg_command(3), leg("set", 91, 45, 120), 60, id="a leg's setpoint"),
        pytest.param(keys.LEGS_COMMAND, _ALL, 120, id="a start of all legs"),
    ],
)
async def test_a_message_reaches_the_device_in_so_many_calls(key: str, payload: object, most: int) -> None:
    robot = await started_and_quiet()
    robot.put(keys.leg_command(3), leg("start", 90, 45, 120))
    await asyncio.sleep(0.05)
    assert calls_to_the_device(robot, key, payload) <= most
