"""Starts without `sent_ms` that a link has held back: of a burst, a leg that does not run takes none."""

import asyncio
import random
from collections.abc import Callable
from dataclasses import replace

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.frames import Op
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.events import Command
from gateway.robot.core.leg import Rules
from schemas import keys
from schemas.telemetry import Kind
from tests.support.robot import Robot, leg
from tests.support.steps import Steps, leg_to

pytestmark = pytest.mark.virtual_time

PERIOD_S = 0.02
STYLES: dict[str, Callable[[int], tuple[int, str]]] = {
    "a start, then sets": lambda turn: (3, "set" if turn else "start"),
    "a start each time": lambda _: (3, "start"),
    "a start each second": lambda turn: (3, "set" if turn % 50 else "start"),
    "six legs in turn": lambda turn: (1 + turn % 6, "start"),
}
"""What programs write every 20 ms: a leg, and what it is to do."""


class WaitingRobot(Robot):
    """With the service's own rules."""

    start_wait_ns = START_WAIT_NS


def made(robot_class: type[Robot] = WaitingRobot) -> Robot:
    robot = robot_class()
    robot.conductor.start()
    robot.conductor.reports.announce_start()
    return robot


@pytest.mark.lengthy
@pytest.mark.parametrize(("robot_class", "moved"), [(WaitingRobot, 0), (Robot, 50)])
async def test_of_fifty_stalls_of_half_a_second_to_ten_none_starts_anything(
    robot_class: type[Robot], moved: int
) -> None:
    """A program drives, its link stalls, the program dies, and the link delivers what it holds, in ticks of some
    messages. Robots that take a start at once do move."""
    found = 0
    for number in range(50):
        stall_s, chance = 0.5 + 9.5 * number / 49, random.Random(number)  # noqa: S311
        robot = made(robot_class)
        robot.put(keys.leg_command(3), leg("start", 90, 90, 90))
        await asyncio.sleep(stall_s)
        back_ms = robot.now_ns() / NS_PER_MS
        style = STYLES[chance.choice(list(STYLES)[1:])]
        for turn in range(round(stall_s / PERIOD_S)):
            at, op = style(turn)
            robot.put_later(keys.leg_command(at), leg(op, 90, 90, 90))
            if chance.random() < 0.15:
                robot.conductor.tick()
                await asyncio.sleep(chance.randint(0, 2) / 1000)
        robot.conductor.tick()
        await asyncio.sleep(1)
        found += any(not frame.is_stop and at_ms >= back_ms for at_ms, frame in robot.frames)
        robot.conductor.close()
    assert found == moved


@pytest.mark.lengthy
@pytest.mark.parametrize("style", STYLES)
async def test_fifty_ordinary_programs_of_each_style_are_not_rejected(style: str) -> None:
    """Each message comes up to 15 ms late, as over Wi-Fi, and in order; a start is written within 20 ms."""
    for number in range(50):
        chance = random.Random(number)  # noqa: S311
        robot = made()
        begun_s = arrives_s = robot.now_ns() / 1e9
        first_ms: dict[int, float] = {}
        for turn in range(50):
            at, op = STYLES[style](turn)
            arrives_s = max(arrives_s, begun_s + turn * PERIOD_S + chance.uniform(0, 0.015))
            await asyncio.sleep(max(0.0, round(arrives_s - robot.now_ns() / 1e9, 5)))
            first_ms.setdefault(at, robot.now_ns() / NS_PER_MS)
            robot.put(keys.leg_command(at), leg(op, 90, 90, 90))
        await asyncio.sleep(0.1)
        assert not robot.events(Kind.COMMAND_REJECTED)
        assert robot.conductor.reports.state().commands.rejected == 0
        begins_ms = {frame.leg: at_ms for at_ms, frame in reversed(robot.frames) if not frame.is_stop}
        assert all(0 <= begins_ms[at] - came_ms <= PERIOD_S * 1000 for at, came_ms in first_ms.items())
        robot.conductor.close()


# ---- one rule at a time

WAIT_MS = START_WAIT_NS / NS_PER_MS
RULES = Rules(repeats=0, rest_runs=0, start_wait_ns=START_WAIT_NS)


def test_a_lone_start_leaves_within_one_slot_with_the_newest_angle() -> None:
    robot = Steps(RULES)
    assert robot.command(100, leg_to(1, "start 90")) == []
    assert robot.command(110, leg_to(1, "set 80")) == ["completed 1 coalesced"]
    assert robot.due_ms == 100 + WAIT_MS
    assert robot.time(100 + WAIT_MS) == ["command 1 start 80", "completed 2"]


def test_the_fourth_message_in_one_slot_is_a_burst_and_no_start_of_it_is_ever_sent() -> None:
    robot = Steps(RULES)
    for at_ms in (100, 101, 102):
        robot.command(at_ms, leg_to(1, "start 90"))
    assert robot.command(103, leg_to(1, "start 90")) == ["rejected 3 stale", "rejected 4 stale"]
    assert robot.due_ms is None
    assert robot.command(200, leg_to(1, "start 90")) == ["rejected 5 stale"]
    assert robot.command(353, leg_to(1, "start 90")) == [], "the watchdog's time has passed without a burst"
    assert robot.time(353 + WAIT_MS) == ["command 1 start 90", "completed 6"]


def test_a_message_behind_the_window_is_of_no_burst_and_a_stop_is_of_none() -> None:
    robot = Steps(RULES)
    for at_ms in (100, 105, 110, 120):
        assert "rejected" not in str(robot.command(at_ms, leg_to(1, "start 90")))
    robot = Steps(RULES)
    for at_ms in (100, 101, 102):
        robot.command(at_ms, leg_to(1, "stop"))
    assert robot.command(103, leg_to(1, "start 90")) == []


def test_a_higher_rate_allows_more_messages_in_the_window() -> None:
    robot = Steps(replace(RULES, period_ns=5 * NS_PER_MS))
    for at_ms in range(100, 106):
        assert "rejected" not in str(robot.command(at_ms, leg_to(1, "start 90")))
    assert "rejected 7 stale" in robot.command(106, leg_to(1, "start 90"))


def test_a_burst_of_one_key_drops_no_start_with_a_time_of_another() -> None:
    robot = Steps(RULES)
    robot.command(100, leg_to(1, "start 90"))
    robot.time(100 + WAIT_MS)
    robot.command(116, leg_to(1, "stop"))
    robot.take(117, Command(leg_to(1, "start 80"), key="another", number=99, sent_ms=1))
    for at_ms in (117, 118, 119):
        robot.command(at_ms, leg_to(2, "set 90"))
    assert "command 1 start 80" in str([robot.time(at_ms) for at_ms in (120, 125, 130, 135)])


def test_sets_are_of_the_burst_too_and_a_start_before_them_is_dropped() -> None:
    robot = Steps(RULES)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 90"))
    robot.command(102, leg_to(1, "set 90"))
    assert robot.command(103, leg_to(1, "set 90")) == ["rejected 3 stale", "rejected 4 servo_stopped"]


def test_a_start_that_a_burst_of_sets_drops_keeps_no_other_leg_waiting() -> None:
    robot = Steps(replace(RULES, start_pause_ns=50 * NS_PER_MS))
    robot.command(50, leg_to(2, "start 90"))
    robot.time(50 + WAIT_MS)
    robot.command(120, leg_to(1, "start 90"))
    robot.take(121, Command(leg_to(3, "start 90"), key="another", number=99, sent_ms=1))
    robot.command(122, leg_to(2, "set 80"))
    robot.command(123, leg_to(2, "set 70"))
    assert robot.command(124, leg_to(2, "set 60")) == [
        "rejected 2 stale",
        "completed 4 coalesced",
        "command 3 start 90",
        "completed 99",
    ]


def test_other_keys_are_not_concerned_and_neither_is_a_leg_that_runs() -> None:
    robot = Steps(RULES)
    robot.command(50, leg_to(1, "start 90"))
    robot.time(50 + WAIT_MS)
    robot.take(100, Command(leg_to(2, "start 90"), key="another", number=99))
    for at_ms in (101, 102, 103, 104, 105):
        assert "rejected" not in " ".join(robot.command(at_ms, leg_to(1, "start 90")))
    assert "command 2 start 90" in robot.time(100 + WAIT_MS)


def test_a_stop_of_a_burst_is_a_stop() -> None:
    robot = Steps(RULES)
    for at_ms in (100, 101, 102, 103):
        robot.command(at_ms, leg_to(1, "start 90"))
    mixed = (*leg_to(1, "start 90"), *leg_to(2, "stop"))
    assert robot.command(104, mixed) == ["command 2 stop", "rejected 5 stale stopped"]
    assert robot.command(105, leg_to(1, "stop")) == ["command 1 stop", "completed 6"]


async def test_with_sent_ms_a_start_leaves_at_once() -> None:
    robot = made()
    answers = robot.get(keys.leg_command(3), leg("start", 90, 90, 90, sent_ms=1.0))
    assert answers[0].accepted
    assert [op.op for _, op in robot.frames[-1][1].servos] == [Op.START] * 3
