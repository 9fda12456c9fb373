"""A landing, from received messages to written frames: what comes in meanwhile, and what the state says."""

import asyncio

import pytest

from gateway.model.frames import Op
from gateway.robot.core.message import Verb
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode, Reason
from tests.support.robot import Robot, leg, started_and_quiet

LANDING = {"timeout_ms": 250, "landing_ms": 1000, "landing": {"31": 30.0, "41": 30.0}}
LEG_3, LEG_4 = keys.leg_command(3), keys.leg_command(4)


async def in_mid_landing() -> Robot:
    """Legs 3 and 4 were started at 90, 45, 120, and have been silent since."""
    robot = await started_and_quiet(watchdog=LANDING, rules={"repeats": 0})
    for key in (LEG_3, LEG_4):
        robot.put(key, leg("start", 90, 45, 120))
    await asyncio.sleep(0.75)
    assert [(event.kind, event.legs) for event in robot.events()] == [(Kind.LANDING, tuple(LEGS))]
    robot.controller.transfers.clear()
    return robot


@pytest.mark.virtual_time
async def test_a_link_that_is_back_with_more_than_a_ring_holds_stops_that_leg_at_once() -> None:
    """A Stop may be among what was pushed out; that it would come later anyway is no reason to leave it out."""
    robot = await in_mid_landing()
    robot.put_later(LEG_3, verb=Verb.LOST)
    for _ in range(3):
        robot.put_later(LEG_3, leg("set", 90, 45, 120))
    robot.put(LEG_3, leg("start", 90, 45, 120))
    ((_, frame),) = robot.frames
    assert frame.is_stop
    assert frame.servos[0][0] == 31
    reasons = [event.reason for event in robot.events(Kind.COMMAND_REJECTED)]
    assert reasons.count(Reason.LANDING) == 4, "of what is left, nothing moves"
    await asyncio.sleep(0.4)
    assert {servo_id for _, frame in robot.frames if not frame.is_stop for servo_id, _ in frame.servos} == {41}
    assert robot.mode == Mode.ACTIVE
    await asyncio.sleep(0.2)
    assert robot.mode == Mode.IDLE


@pytest.mark.virtual_time
async def test_the_state_tells_where_each_servo_is_on_its_way_down() -> None:
    robot = await in_mid_landing()
    state = robot.conductor.state()
    first, second, _ = state.legs[2].servos
    assert first.angle_deg is not None
    assert 30 < first.angle_deg < 90
    assert (second.running, second.angle_deg) == (True, 45)
    assert not any(servo.running for servo in state.legs[0].servos)
    assert {op.op for _, frame in robot.frames for _, op in frame.servos} <= {Op.SET}
