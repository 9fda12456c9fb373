"""The preamble in the pauses of a stream, from the conductor to the controller, in virtual time."""

import asyncio
from itertools import pairwise

import pytest

from gateway.model.frames import stop_leg
from gateway.model.framing import ZERO, Framing
from schemas import keys
from schemas.robot import LEGS
from tests.support.robot import MS, Robot, leg, started_and_quiet
from tests.support.transfers import on_wire

pytestmark = pytest.mark.virtual_time

LEG_1, LEG_3 = keys.leg_command(1), keys.leg_command(3)
START, SET = leg("start", 90, 90, 90), leg("set", 91, 91, 91)
SIX_STOPS = on_wire(Framing.LENGTH_PREFIXED, *map(stop_leg, LEGS))


async def prefixed(frame_gap_us: float = 20, repeats: int = 3, **watchdog: float) -> Robot:
    spi = {"framing": "length-prefixed", "frame_gap_us": frame_gap_us}
    robot = await started_and_quiet(spi=spi, watchdog=watchdog, rules={"repeats": repeats})
    await asyncio.sleep(1)  # long enough for the bus to count as synchronised by its rest
    assert robot.controller.energised == frozenset()
    return robot


def runs(robot: Robot) -> list[tuple[str, float, int]]:
    """The transfers as runs: ("zeros" or "frames", when it began in ms, how many)."""
    found: list[tuple[str, float, int]] = []
    for at_ns, data in robot.controller.transfers:
        kind = "zeros" if data == ZERO else "frames"
        if found and found[-1][0] == kind and (kind == "zeros" or at_ns / MS - found[-1][1] < 1):
            found[-1] = (kind, found[-1][1], found[-1][2] + 1)
        else:
            found.append((kind, at_ns / MS, 1))
    return found


async def test_the_first_stops_leave_at_once_and_each_repeat_finds_its_preamble_written() -> None:
    robot = await prefixed()
    robot.put(LEG_3, START)
    await asyncio.sleep(0.05)
    robot.controller.transfers.clear()
    begun_ms = robot.now_ns() / MS
    assert robot.ask(keys.ESTOP).stop_frames == 6
    assert [data for _, data in robot.controller.transfers] == SIX_STOPS
    await asyncio.sleep(1)
    found = runs(robot)
    assert [(kind, count) for kind, _, count in found] == [("frames", 12), *[("zeros", 16), ("frames", 12)] * 3]
    stops_ms = [at_ms - begun_ms for kind, at_ms, _ in found if kind == "frames"]
    assert stops_ms == pytest.approx([0, 20, 40, 60], abs=0.01)
    for (kind, zeros_ms, _), (_, repeat_ms, _) in pairwise(found):
        if kind == "zeros":
            assert 2 < repeat_ms - zeros_ms < 6, "in the pause, and none too early"


async def test_a_deaf_controller_hears_the_first_repeat() -> None:
    for lost in range(1, 30):
        robot = await prefixed()
        for number in LEGS:
            robot.put(keys.leg_command(number), START)
        assert len(robot.controller.energised) == 18
        await asyncio.sleep(0.03)
        robot.controller.lose_bytes(lost)
        assert robot.ask(keys.ESTOP).stop_frames == 6
        await asyncio.sleep(0.02)
        assert robot.controller.energised == frozenset()
        robot.conductor.close()
