"""Stops to legs at rest (Behaviour 4): a servo that nobody started does not stay on."""

import asyncio

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.frames import stop_leg
from gateway.model.framing import Framing
from gateway.robot.core.events import Transmit
from gateway.robot.core.leg import Rules
from schemas import keys
from schemas.robot import LEGS
from tests.support.robot import MS, Robot, leg, started_and_quiet
from tests.support.steps import Steps, leg_to, legs_to, servo_to, staggered
from tests.support.transfers import on_wire, preamble_of

LEG_3, LEG_4 = keys.leg_command(3), keys.leg_command(4)
PREFIXED = Framing.LENGTH_PREFIXED
SET = leg("set", 10, 10, 10)


def stopped_too(robot: Steps) -> list[int]:
    """The legs at rest that get a Stop behind the step's first Stops."""
    joining = robot.joining
    stops = [effect for effect in robot.effects if isinstance(effect, Transmit) and effect.frame.is_stop]
    assert stops[len(stops) - len(joining) :] == joining, "first Stops come first"
    return [effect.frame.servos[0][0] // 10 for effect in joining]


# ---- when, and to whom


def test_legs_at_rest_are_stopped_with_a_silent_leg_and_those_that_run_are_not() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(2, "start 90"))
    assert robot.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]
    assert stopped_too(robot) == [3, 4, 5, 6]
    assert robot.running == [21, 22, 23]


def test_a_leg_whose_stop_is_to_be_repeated_gets_no_other() -> None:
    robot = Steps(Rules(repeats=1, repeat_interval_ns=20 * NS_PER_MS))
    robot.time(20)
    for number in (1, 2, 3):
        robot.command(100 + number, leg_to(number, "start 90"))
    robot.time(351)
    assert stopped_too(robot) == [4, 5, 6]
    robot.time(352)
    assert stopped_too(robot) == []


def test_while_others_run_each_leg_at_rest_gets_a_stop_every_800_ms() -> None:
    robot = Steps(Rules(repeats=0, timeout_ns=10_000 * NS_PER_MS))
    robot.command(100, legs_to("1", "start 90"))
    robot.command(800, servo_to(21, "start 90"))
    assert robot.due_ms == 900
    assert robot.time(899) == []
    assert robot.time(900) == [f"repeat {number} stop" for number in (3, 4, 5, 6)]
    assert robot.due_ms == 1700


def test_the_rounds_go_on_at_their_time_however_many_commands_come() -> None:
    robot = Steps()
    robot.command(10, leg_to(1, "start 90"))
    for at_ms in range(50, 800, 50):
        assert robot.command(at_ms, leg_to(1, "set 80"))[:1] == ["command 1 set 80"]
    assert robot.command(810, leg_to(1, "set 80"))[:5] == [f"repeat {number} stop" for number in range(2, 7)]


def test_a_start_in_the_step_of_a_round_is_not_undone() -> None:
    robot = Steps()
    robot.command(10, leg_to(1, "start 90"))
    for at_ms in range(200, 800, 200):
        robot.command(at_ms, leg_to(1, "set 90"))
    assert robot.command(810, leg_to(2, "start 90")) == [
        "repeat 3 stop",
        "repeat 4 stop",
        "repeat 5 stop",
        "repeat 6 stop",
        "command 2 start 90",
        "completed 5",
    ]


def test_where_all_legs_run_there_is_no_round() -> None:
    robot = Steps(Rules(repeats=0, timeout_ns=10_000 * NS_PER_MS))
    robot.command(10, legs_to("123456", "start 90"))
    assert robot.due_ms == 10_010


def test_the_last_stop_is_one_for_all_legs_with_its_repeats() -> None:
    robot = Steps(Rules(repeats=1, repeat_interval_ns=20 * NS_PER_MS))
    robot.time(20)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, servo_to(21, "start 90"))
    robot.command(200, leg_to(1, "stop"))
    assert stopped_too(robot) == [], "leg 2 runs on"
    assert robot.command(210, servo_to(21, "stop")) == ["command 21 stop", "completed 4"]
    assert stopped_too(robot) == [2, 3, 4, 5, 6], "leg 1's is still to be repeated"
    assert robot.due_ms == 230
    assert robot.time(230) == [f"repeat {number} stop" for number in LEGS]
    assert robot.due_ms is None, "at rest nothing is due"


def test_a_leg_that_waits_to_be_started_gets_none() -> None:
    robot = staggered(50)
    robot.command(100, legs_to("12", "start 90"))
    robot.command(110, (*leg_to(1, "stop"), *leg_to(3, "start 90")))
    assert stopped_too(robot) == [2, 4, 5, 6], "leg 2's start is dropped, and leg 3's waits"


def test_a_round_uses_no_rate_slot_and_the_state_says_what_it_said() -> None:
    robot = Steps()
    robot.command(10, leg_to(2, "start 90"))
    robot.time(260)
    robot.command(300, leg_to(1, "start 90"))
    slots = [each.slots.next_ns for each in robot.supervisor.legs]
    robot.time(550)
    assert stopped_too(robot) == [2, 3, 4, 5, 6]
    assert [each.slots.next_ns for each in robot.supervisor.legs] == slots
    assert [each.watchdog for each in robot.supervisor.legs][:3] == ["expired", "expired", "idle"]


# ---- on the wire, where a controller loses five bytes


async def walking() -> Robot:
    """Legs 3 and 4 walk, and servo 21 runs: of leg 3's Set five bytes were lost, and leg 4's frame came behind it."""
    spi = {"framing": PREFIXED}
    robot = await started_and_quiet(spi=spi)
    await asyncio.sleep(1)
    for key in (LEG_3, LEG_4):
        robot.put(key, leg("start", 10, 10, 10))
    await walk(robot, 0.1)
    robot.controller.lose_bytes(5, behind=1 + 9)
    await walk(robot, 0.02)
    assert robot.controller.energised == {21, 31, 32, 33, 41, 42, 43}
    return robot


async def walk(robot: Robot, seconds: float, *legs: str) -> None:
    """Setpoints at 50 Hz."""
    for _ in range(round(seconds * 50)):
        await asyncio.sleep(0.02)
        for key in legs or (LEG_3, LEG_4):
            robot.put(key, SET)


@pytest.mark.virtual_time
async def test_a_servo_that_nobody_started_is_off_within_a_second_while_others_walk() -> None:
    robot = await walking()
    await walk(robot, 0.9)
    assert robot.controller.energised == {31, 32, 33, 41, 42, 43}


@pytest.mark.virtual_time
async def test_it_is_off_when_a_leg_is_silent() -> None:
    robot = await walking()
    await walk(robot, 0.3, LEG_4)
    assert robot.controller.energised == {41, 42, 43}


@pytest.mark.virtual_time
async def test_it_is_off_when_all_come_to_rest() -> None:
    robot = await walking()
    for key in (LEG_3, LEG_4):
        robot.put(key, leg("stop"))
    await asyncio.sleep(0.03)  # the first repeat: the controller may be out of sync until its preamble
    assert robot.controller.energised == set()


@pytest.mark.virtual_time
async def test_they_leave_with_the_first_stop_and_no_preamble_between() -> None:
    robot = await started_and_quiet(spi={"framing": PREFIXED})
    robot.put(LEG_3, leg("start", 10, 10, 10))
    robot.controller.transfers.clear()
    calls = sum(robot.conductor.bus.transfer_latency.buckets)
    robot.put(LEG_3, leg("stop"))
    others = [stop_leg(number) for number in LEGS if number != 3]
    assert [data for _, data in robot.controller.transfers] == on_wire(PREFIXED, stop_leg(3), *others)
    assert sum(robot.conductor.bus.transfer_latency.buckets) == calls + 1


@pytest.mark.virtual_time
async def test_a_round_finds_its_preamble_written_and_is_the_streams_only_one() -> None:
    robot = await started_and_quiet(spi={"framing": PREFIXED})
    await asyncio.sleep(1)
    robot.put(LEG_3, leg("start", 10, 10, 10))
    robot.controller.transfers.clear()
    begun_ns = robot.now_ns()
    await walk(robot, 2.5, LEG_3)
    data = [data for _, data in robot.controller.transfers]
    stops = on_wire(PREFIXED, *(stop_leg(number) for number in LEGS if number != 3))
    found = [index for index in range(len(data)) if data[index : index + len(stops)] == stops]
    assert [round((robot.controller.transfers[index][0] - begun_ns) / MS) for index in found] == [800, 1600, 2400]
    for index in found:
        assert data[index - 16 : index] == preamble_of(PREFIXED)
    assert data.count(b"\0") == 3 * 16
