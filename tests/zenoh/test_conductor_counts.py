"""What the conductor counts, measures and tells, and what it does with a device that will not open."""

import asyncio
import itertools

import pytest

from gateway.model.frames import OneLeg, Op, ServoOp, stop_leg
from gateway.model.framing import PREAMBLE_ZEROS, ZERO
from gateway.robot.core.events import Transmit
from schemas import keys
from schemas.telemetry import Cause, Reason
from tests.support.robot import LEG_1, LEG_3, MS, START, leg, started_and_quiet

pytestmark = pytest.mark.virtual_time


# ---- the emergency stop


async def test_an_emergency_stop_says_how_long_it_took_and_is_measured() -> None:
    robot = await started_and_quiet()
    ack = robot.ask(keys.ESTOP, received_ns=robot.now_ns() - 3 * MS)
    assert ack.stop_frames == 6
    assert ack.latency_us == pytest.approx(3000, abs=1)
    assert list(robot.conductor.metrics.emergency_stops.recent_us) == [ack.latency_us]
    robot.controller.fail_next(1)
    ack = robot.ask(keys.ESTOP)
    assert ack.stop_frames == 6, "those that failed were tried again at once"
    robot.controller.fail_next(1000)
    ack = robot.ask(keys.ESTOP)
    assert ack.stop_frames == 0
    assert len(robot.conductor.metrics.emergency_stops.recent_us) == 2, "that was none for all legs"
    assert robot.ask(keys.ESTOP, received_ns=robot.now_ns() + MS).latency_us == 0, "none is negative"


# ---- counters and events


async def test_frames_are_counted_by_their_cause_and_commands_by_what_became_of_them() -> None:
    robot = await started_and_quiet()
    metrics = robot.conductor.metrics
    before = dict(metrics.frames)
    robot.put(LEG_3, START)
    for _ in range(3):
        robot.put(LEG_3, leg("set", 80, 80, 80))
    robot.put(LEG_1, leg("set", 80, 80, 80))
    await asyncio.sleep(0.1)
    assert metrics.frames[Cause.COMMAND] - before.get(Cause.COMMAND, 0) == 2
    assert (metrics.accepted, metrics.coalesced) == (4, 2)
    assert metrics.rejected[Reason.SERVO_STOPPED] == 1


# ---- failed transfers


async def test_after_a_stop_that_failed_nothing_of_its_command_moves() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_1, START)
    robot.controller.fail_next(1)
    both = {"legs": {"1": leg("stop"), "2": START}}
    assert robot.ask(keys.LEGS_COMMAND, both).reason == Reason.BUS_FAULT
    assert not robot.controller.energised & {21, 22, 23}


async def test_stops_leave_before_repeated_ones_and_these_before_what_moves() -> None:
    robot = await started_and_quiet()
    move = OneLeg(2, (ServoOp(Op.START, 90_00),) * 3)
    effects = [Transmit(stop_leg(1), Cause.COMMAND), Transmit(stop_leg(3), Cause.REPEAT), Transmit(move, Cause.COMMAND)]
    for order in itertools.permutations(effects):
        written = robot.conductor.executor.carry_out(order).written
        assert [transmit for transmit, _ in written] == effects


async def test_a_device_that_takes_no_lists_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    robot = await started_and_quiet()
    robot.take_no_lists()
    for _ in range(2):
        assert robot.ask(keys.ESTOP).stop_frames == 6
    assert caplog.messages.count("no lists; from now on, each transfer is a separate call") == 1


async def test_the_end_says_whether_all_six_stops_were_written() -> None:
    robot = await started_and_quiet()
    assert robot.conductor.shut_down()
    robot = await started_and_quiet()
    robot.controller.fail_next(1)
    assert not robot.conductor.shut_down()


async def test_the_stops_behind_an_opening_are_repeated_though_nothing_else_comes() -> None:
    robot = await started_and_quiet()
    repeats = robot.conductor.metrics.frames[Cause.REPEAT]
    robot.controller.fail_next(1)
    robot.put(LEG_1, START)
    await asyncio.sleep(0.1)
    assert robot.conductor.metrics.frames[Cause.REPEAT] - repeats == 3 * 6


# ---- the preamble


async def test_repeated_stops_whose_pause_was_not_filled_still_find_a_whole_preamble() -> None:
    """The loop was held until they were due."""
    robot = await started_and_quiet(spi={"framing": "length-prefixed"})
    await asyncio.sleep(1)
    robot.controller.transfers.clear()
    robot.ask(keys.ESTOP)
    robot.sleep_through(0.03)
    robot.conductor.tick()
    written = [data for _, data in robot.controller.transfers]
    stops = 12
    assert len(written) == stops + PREAMBLE_ZEROS + stops
    assert written[stops:-stops] == [ZERO] * PREAMBLE_ZEROS
