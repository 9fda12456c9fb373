"""Commands from a received message to frames, answers and reports, in virtual time."""

import asyncio

import pytest

from gateway.robot.core.message import Verb
from schemas import keys
from schemas.telemetry import Kind, Mode, Reason
from tests.support.robot import Robot, leg, started_and_quiet

pytestmark = pytest.mark.virtual_time

LEG_3 = keys.leg_command(3)


async def test_a_reset_is_never_taken_from_a_delete_or_a_wildcard() -> None:
    robot = await started_and_quiet()
    robot.put(keys.ESTOP)
    robot.put(keys.RESET, verb=Verb.DELETE)
    robot.put(keys.RESET, expression="hexapod/**/cmd")
    assert robot.mode == Mode.ESTOPPED
    robot.put(keys.RESET, {"estop": 1})
    assert robot.mode == Mode.IDLE


async def test_an_unknown_key_is_rejected_and_the_next_good_command_works() -> None:
    robot = await started_and_quiet()
    ack = robot.ask("hexapod/leg/7/cmd", leg("start", 1, 2, 3))
    assert (ack.accepted, ack.reason, ack.detail) == (False, Reason.INVALID, "leg 7 does not exist; legs are 1 to 6")
    assert robot.frames == []
    assert robot.ask(LEG_3, leg("start", 1, 2, 3)).accepted


async def test_two_laptops_on_one_leg_are_both_named() -> None:
    robot = Robot()
    robot.conductor.start()
    robot.put(LEG_3, leg("start", 1, 2, 3, source="anna"))
    robot.put(LEG_3, leg("set", 2, 2, 3, source="anna"))
    assert not robot.events(Kind.SOURCE_CHANGED), "the leg was nobody's before"
    assert robot.conductor.reports.state().legs[2].source == "anna"
    robot.put(LEG_3, leg("set", 3, 2, 3), source="0123abc")
    (event,) = robot.events(Kind.SOURCE_CHANGED)
    assert (event.source, event.detail) == ("0123abc", "leg 3 is commanded by 0123abc, and was by anna")
    assert event.legs == (3,)
    robot.put(LEG_3, {"servos": [{"op": "stop"}] * 3, "source": "ben"})
    assert robot.events(Kind.SOURCE_CHANGED)[-1].detail == "leg 3 is commanded by ben, and was by 0123abc"
    assert [each.source for each in robot.conductor.reports.state().legs] == [None, None, "ben", None, None, None]
    robot.put(LEG_3, leg("start", 1, 2, 3, source="anna"))
    assert len(robot.events(Kind.SOURCE_CHANGED)) == 2, "a stopped leg is taken from nobody"
    await asyncio.sleep(1)
    assert robot.conductor.reports.state().legs[2].source is None, "the watchdog has stopped it"


@pytest.mark.virtual_time
@pytest.mark.parametrize(
    "key", ["hexapod/leg/{}/cmd", "hexapod/{}/cmd", "hexapod/" + "x" * 86 + "{}/cmd", "{0}/{0}/cmd"]
)
async def test_a_rejection_repeats_no_token_that_stands_in_a_key(key: str) -> None:
    robot = Robot()
    token = "0123456789abcdef" * 2
    ack = robot.ask(key.format(token), {})
    robot.conductor.answers.reject_unread(key.format(token), None, "nothing reads this key")
    rejections = robot.events(Kind.COMMAND_REJECTED)
    assert len(rejections) == 2
    assert not any(token in report.model_dump_json() for report in (ack, *rejections))
