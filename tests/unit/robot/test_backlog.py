"""Starts without `sent_ms` that a link has held back: of a burst, a leg that does not run takes none."""

import asyncio
import random
from collections.abc import Callable
from typing import Final

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.backlog import START_WAIT_NS
from schemas import keys
from tests.support.robot import Robot, leg
from tests.support.scenes import play, scene_test

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


# ---- one rule at a time

RULES: Final = f"rules start_wait_ms={START_WAIT_NS / NS_PER_MS}\n"
STAGGERED: Final = RULES.replace("rules", "rules start_pause_ms=50,")


def test_the_fourth_message_in_one_slot_is_a_burst_and_no_start_of_it_is_ever_sent() -> None:
    play(f"""{RULES}
        100 leg 1 start 90
        101 leg 1 start 90
        102 leg 1 start 90
        103 leg 1 start 90 → rejected 3 stale; rejected 4 stale
        due never
        200 leg 1 start 90 → rejected 5 stale
        353 leg 1 start 90 → nothing  # the watchdog's time has passed without a burst
        368 time → command 1 start 90; completed 6""")


SCENES: Final = {
    "a lone start leaves within one slot with the newest angle": f"""{RULES}
        100 leg 1 start 90 → nothing
        110 leg 1 set 80 → completed 1 coalesced
        due 115
        115 time → command 1 start 80; completed 2""",
    "a message behind the window is of no burst": f"""{RULES}
        100 leg 1 start 90 → nothing
        105 leg 1 start 90 → completed 1 coalesced
        110 leg 1 start 90 → completed 2 coalesced
        120 leg 1 start 90 → completed 3 coalesced; command 1 start 90; completed 4""",
    "a stop is of none": f"""{RULES}
        100 leg 1 stop
        101 leg 1 stop
        102 leg 1 stop
        103 leg 1 start 90 → nothing""",
    "a higher rate allows more messages in the window": f"""{RULES.replace("rules", "rules period_ms=5,")}
        100 leg 1 start 90
        101 leg 1 start 90 → completed 1 coalesced
        102 leg 1 start 90 → completed 2 coalesced
        103 leg 1 start 90 → completed 3 coalesced
        104 leg 1 start 90 → completed 4 coalesced
        105 leg 1 start 90 → completed 5 coalesced
        106 leg 1 start 90 → …; rejected 7 stale; …""",
    "sets are of the burst too and a start before them is dropped": f"""{RULES}
        100 leg 1 start 90
        101 leg 1 set 90
        102 leg 1 set 90
        103 leg 1 set 90 → rejected 3 stale; rejected 4 servo_stopped""",
    "a start that a burst of sets drops keeps no other leg waiting": f"""{STAGGERED}
        50 leg 2 start 90
        65 time
        120 leg 1 start 90
        121 timed leg 3 start 90
        122 leg 2 set 80
        123 leg 2 set 70
        124 leg 2 set 60 → rejected 2 stale; completed 4 coalesced; command 3 start 90; completed 99""",
    "other keys are not concerned and neither is a leg that runs": f"""{RULES}
        50 leg 1 start 90
        65 time
        100 leg 2 start 90 (key another)
        101 leg 1 start 90 → command 1 start 90; completed 3
        102 leg 1 start 90 → nothing
        103 leg 1 start 90 → completed 4 coalesced
        104 leg 1 start 90 → completed 5 coalesced
        105 leg 1 start 90 → completed 6 coalesced
        115 time → …; command 2 start 90; …""",
    "a stop of a burst is a stop": f"""{RULES}
        100 leg 1 start 90
        101 leg 1 start 90
        102 leg 1 start 90
        103 leg 1 start 90
        104 leg 1 start 90 + leg 2 stop → command 2 stop; rejected 5 stale stopped
        105 leg 1 stop → command 1 stop; completed 6""",
}
test_a_scene = scene_test(SCENES)
