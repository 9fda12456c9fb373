"""The preamble in the pauses of a stream, from the conductor to the controller, in virtual time."""

import asyncio
from itertools import pairwise

import pytest

from gateway.model.frames import stop_leg
from gateway.model.framing import PREAMBLE_ZEROS, ZERO, Framing
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode
from tests.support.robot import MS, Robot, leg, started_and_quiet
from tests.support.transfers import on_wire, preamble_of

pytestmark = pytest.mark.virtual_time

LEG_1, LEG_3 = keys.leg_command(1), keys.leg_command(3)
START, SET = leg("start", 90, 90, 90), leg("set", 91, 91, 91)
SIX_STOPS = on_wire(Framing.LENGTH_PREFIXED, *map(stop_leg, LEGS))
STOP_3 = stop_leg(3).to_bytes()


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


def start_all(robot: Robot) -> None:
    """No leg is at rest, so none gets a Stop ahead of which there would be a preamble."""
    robot.put(keys.LEGS_COMMAND, {"legs": {str(number): START for number in LEGS}})


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


async def test_the_next_repeat_too_where_another_leg_writes_into_the_pause() -> None:
    robot = await prefixed()
    robot.put(LEG_1, START)
    robot.put(LEG_3, START)
    await asyncio.sleep(0.03)
    robot.controller.transfers.clear()
    robot.put(LEG_3, leg("stop"))
    for _ in range(100):
        await asyncio.sleep(0.001)
        robot.put(LEG_1, SET)
    data = [data for _, data in robot.controller.transfers]
    stops = [index for index, each in enumerate(data) if each == STOP_3]
    assert len(stops) == 4
    for repeat in stops[1:]:
        assert data[repeat - 1 - PREAMBLE_ZEROS : repeat - 1] == preamble_of(Framing.LENGTH_PREFIXED)
    assert data[stops[0] - 2] != ZERO


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


async def test_a_stream_has_it_in_a_pause_behind_its_frames() -> None:
    robot = await prefixed(timeout_ms=10_000)
    start_all(robot)
    for _ in range(250):
        await asyncio.sleep(0.02)
        robot.put(LEG_3, SET)
        robot.put(LEG_1, SET)
    zeros_ms = [at_ms for kind, at_ms, count in runs(robot) if kind == "zeros"]
    assert [count for kind, _, count in runs(robot) if kind == "zeros"] == [16] * len(zeros_ms)
    assert len(zeros_ms) == 5
    assert [later - earlier for earlier, later in pairwise(zeros_ms)] == pytest.approx([880] * 4, abs=25)


async def test_a_stream_of_first_stops_has_it_behind_them() -> None:
    robot = await prefixed(repeats=0)
    for _ in range(250):
        await asyncio.sleep(0.02)
        before = len(robot.controller.transfers)
        robot.put(LEG_3, leg("stop"))
        assert [data for _, data in robot.controller.transfers][before:] == [b"\x0e", STOP_3]
    zeros = [count for kind, _, count in runs(robot) if kind == "zeros"]
    assert zeros == [16] * 8, "those of the stream, and those ahead of four runs for legs at rest"


async def test_a_slow_stream_has_it_ahead_of_a_frame() -> None:
    robot = await prefixed(repeats=0, timeout_ms=10_000)
    start_all(robot)
    for _ in range(6):
        await asyncio.sleep(0.7)
        robot.put(LEG_3, SET)
    kinds = [(kind, count) for kind, _, count in runs(robot)]
    assert kinds[:7] == [
        ("frames", 12),
        ("frames", 2),
        ("zeros", 16),
        *[("frames", 2)] * 2,
        ("zeros", 16),
        ("frames", 2),
    ]


async def test_a_first_stop_comes_into_a_preamble_that_is_under_way() -> None:
    robot = await prefixed(timeout_ms=10_000)
    start_all(robot)
    while not robot.bus.resync_due:
        await asyncio.sleep(0.02)
        robot.put(LEG_3, SET)
    for _ in range(20):  # turns of the loop
        if any(data == ZERO for _, data in robot.controller.transfers):
            break
        await asyncio.sleep(0)
    before = len(robot.controller.transfers)
    assert 0 < [data for _, data in robot.controller.transfers].count(ZERO) < PREAMBLE_ZEROS
    assert robot.ask(keys.ESTOP).stop_frames == 6
    assert [data for _, data in robot.controller.transfers][before:] == SIX_STOPS


async def test_a_zero_that_fails_is_a_fault_of_the_bus() -> None:
    robot = await prefixed()
    robot.put(LEG_3, START)
    robot.put(LEG_3, leg("stop"))
    await asyncio.sleep(0.0001)
    robot.controller.fail_next(1)  # the first zero ahead of the repeat
    await asyncio.sleep(0.019)
    assert robot.mode == Mode.IDLE, "opened again at once"
    assert [event.kind for event in robot.events()][-2:] == [Kind.BUS_FAULT, Kind.BUS_RECOVERED]
    assert [state.mode for state in robot.states][-2:] == [Mode.BUS_FAULT, Mode.IDLE]
