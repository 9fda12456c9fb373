"""What the conductor counts, measures and tells, and what it does with a device that will not open."""

import asyncio
import itertools

import pytest

from gateway.errors import SpiError
from gateway.model.frames import OneLeg, Op, ServoOp, stop_leg
from gateway.model.framing import PREAMBLE_ZEROS, ZERO
from gateway.robot.core.events import Transmit
from gateway.robot.core.intake import MAX_KEY
from schemas import keys
from schemas.telemetry import Cause, Kind, Mode, Reason
from tests.support.faulty_controller import FaultyController
from tests.support.robot import MS, Robot, leg, started_and_quiet

pytestmark = pytest.mark.virtual_time

LEG_1, LEG_3 = keys.leg_command(1), keys.leg_command(3)
START = leg("start", 90, 90, 90)


class WillNotOpen:
    """Stands in front of a robot's device, and fails to open it so many times."""

    def __init__(self, robot: Robot, times: int) -> None:
        self._robot, self._left = robot, times
        self.tried_ns: list[int] = []
        robot.bus._open_device = self

    def __call__(self) -> FaultyController:
        self.tried_ns.append(self._robot.now_ns())
        self._left -= 1
        if self._left >= 0:
            raise SpiError("no such device")
        return self._robot.controller


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


async def test_an_event_repeats_little_of_a_key_of_the_senders_own_making() -> None:
    robot = await started_and_quiet()
    robot.put("hexapod/x/cmd", expression="hexapod/" + "x" * 4000 + "/cmd", target=None)
    (event,) = robot.events(Kind.COMMAND_REJECTED)
    assert event.key is not None
    assert len(event.key) == MAX_KEY == 100
    robot.conductor.announce(Kind.REVOKED, "bert", keys.REVOCATION)
    (event,) = robot.events(Kind.REVOKED)
    assert (event.detail, event.key) == ("bert", keys.REVOCATION)


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
        written = robot.conductor._carry_out(order).written
        assert [transmit for transmit, _ in written] == effects


async def test_a_device_that_takes_no_lists_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    robot = await started_and_quiet()
    robot.take_no_lists()
    for _ in range(2):
        assert robot.ask(keys.ESTOP).stop_frames == 6
    assert caplog.messages.count("no lists; from now on each transfer is a call of its own") == 1


async def test_the_end_says_whether_all_six_stops_were_written() -> None:
    robot = await started_and_quiet()
    assert robot.conductor.shut_down()
    robot = await started_and_quiet()
    robot.controller.fail_next(1)
    assert not robot.conductor.shut_down()


async def test_a_device_that_will_not_open_is_tried_again_and_again_with_the_same_pauses() -> None:
    robot = await started_and_quiet()
    device = WillNotOpen(robot, 10)
    for _ in range(2):
        robot.controller.fail_next(1)
        robot.put(LEG_1, START)
        failed_ns = robot.now_ns()
        assert robot.mode == Mode.BUS_FAULT
        await asyncio.sleep(10)
        assert robot.mode == Mode.IDLE
        assert device.tried_ns[0] - failed_ns <= 100 * MS, "also after a second fault"
        pauses_ms = [
            (later - earlier) / MS for earlier, later in zip(device.tried_ns, device.tried_ns[1:], strict=False)
        ]
        assert pauses_ms == pytest.approx([20] * len(pauses_ms), abs=0.1), "no leg is known to be stopped meanwhile"
        device = WillNotOpen(robot, 10)
    assert len(robot.events(Kind.BUS_FAULT)) == len(robot.events(Kind.BUS_RECOVERED)) == 2, "each fault is told once"
    assert robot.conductor.bus.errors == 2 + 2 * 10, "nothing is written to what is not open"


async def test_the_stops_behind_an_opening_are_repeated_though_nothing_else_comes() -> None:
    robot = await started_and_quiet()
    repeats = robot.conductor.metrics.frames[Cause.REPEAT]
    robot.controller.fail_next(1)
    robot.put(LEG_1, START)
    await asyncio.sleep(0.1)
    assert robot.conductor.metrics.frames[Cause.REPEAT] - repeats == 3 * 6


async def test_the_end_releases_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet()
    closed: list[bool] = []
    monkeypatch.setattr(robot.controller, "close", lambda: closed.append(True))
    robot.conductor.close()
    assert closed == [True]


async def test_after_the_end_no_timer_opens_the_device_again() -> None:
    robot = await started_and_quiet()
    device = WillNotOpen(robot, 1000)
    robot.controller.fail_next(1)
    robot.put(LEG_1, START)
    await asyncio.sleep(0.1)
    robot.conductor.close()
    tried = len(device.tried_ns)
    await asyncio.sleep(1)
    assert len(device.tried_ns) == tried > 1


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
