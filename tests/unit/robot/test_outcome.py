"""What became of a step's requests: a fault rejects the commands whose frames failed, and no others."""

import asyncio

import pytest

from gateway.model.frames import stop_leg
from gateway.robot.core.events import Command, Completed, Effect, Rejected, Reset, Transmit, Verdict, results
from schemas import keys
from schemas.telemetry import Cause, Kind, Mode, Reason
from tests.support.robot import Robot, leg, started_and_quiet
from tests.unit.robot.test_calibration_conductor import OWN, Disk, on_disk

pytestmark = pytest.mark.virtual_time

LEG_1, LEG_3 = keys.leg_command(1), keys.leg_command(3)
START = leg("start", 90, 90, 90)
FIRST, SECOND, REPLACED = Command(number=1), Command(number=2), Command(number=3)
REPLACED.coalesced = True
RESET = Reset(number=4)
OF_FIRST = Transmit(stop_leg(1), Cause.COMMAND, None, (FIRST,))
OF_SECOND = Transmit(stop_leg(2), Cause.COMMAND, None, (SECOND,), (SECOND,))
WATCHDOGS = Transmit(stop_leg(3), Cause.WATCHDOG)
EFFECTS: list[Effect] = [
    OF_FIRST, OF_SECOND, WATCHDOGS, Completed(FIRST), Completed(REPLACED), Completed(RESET),
    Rejected(Command(number=5), Reason.STALE, "late"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("failed", "lost"),
    [
        ([], []),
        ([WATCHDOGS], []),
        ([OF_FIRST], [1]),
        ([OF_SECOND], [2]),
        ([OF_FIRST, OF_SECOND, WATCHDOGS], [1, 2]),
    ],
)
def test_a_fault_rejects_what_a_failed_frame_names(failed: list[Transmit], lost: list[int]) -> None:
    verdicts: dict[int, Verdict] = {2: "accepted", 1: "accepted", 3: "coalesced", 4: "accepted", 5: Reason.STALE}
    expected = verdicts | dict.fromkeys(lost, Reason.BUS_FAULT)
    found = results(EFFECTS, failed, "no device")
    assert [(request.number, verdict) for request, verdict, _ in found] == list(expected.items())
    assert {detail for _, verdict, detail in found if verdict is Reason.BUS_FAULT} == ({"no device"} if lost else set())


async def estopped_with_repeats_due(robot: Robot) -> None:
    """The next step writes repeated Stops, which fail."""
    robot.put(keys.ESTOP)
    robot.sleep_through(0.03)
    robot.controller.fail_where(lambda _: True)


async def test_a_reset_whose_step_cannot_write_repeated_stops_is_accepted() -> None:
    robot = await started_and_quiet()
    await estopped_with_repeats_due(robot)
    accepted = robot.conductor.metrics.accepted
    ack = robot.ask(keys.RESET, {"estop": 1})
    assert (ack.accepted, robot.mode) == (True, Mode.BUS_FAULT)
    assert robot.conductor.metrics.accepted == accepted + 1
    assert len(robot.events(Kind.ESTOP_RESET)) == 1
    assert not robot.events(Kind.COMMAND_REJECTED)
    robot.controller.fail_where(lambda _: False)
    await asyncio.sleep(0.1)
    assert robot.mode == Mode.IDLE, "as its answer says"


async def test_a_calibration_that_is_kept_while_stops_fail_is_accepted() -> None:
    disk = Disk()
    robot = await on_disk(disk)
    robot.put(keys.ESTOP)
    robot.put(keys.RESET, {"estop": 1})
    answers = robot.calibrate(OWN)
    robot.sleep_through(0.03)
    robot.controller.fail_where(lambda _: True)
    disk.write()
    assert [ack.accepted for ack in answers] == [True]
    assert robot.mode == Mode.BUS_FAULT
    assert robot.conductor.supervisor.calibrating.in_force.revision == 1


async def test_a_stop_that_was_written_is_accepted_though_another_commands_frame_fails() -> None:
    """Leg 1's start leaves in the same step, behind the Stop of leg 3."""
    robot = await started_and_quiet(limits={"leg_rate_hz": 10})
    robot.put(LEG_1, START)
    answers = robot.get(LEG_1, leg("set", 45, 45, 45))
    robot.sleep_through(0.2)
    robot.controller.fail_where(lambda data: data != stop_leg(3).data)
    stopped = robot.ask(LEG_3, leg("stop"))
    assert (stopped.accepted, robot.mode) == (True, Mode.BUS_FAULT)
    assert [(ack.accepted, ack.reason) for ack in answers] == [(False, Reason.BUS_FAULT)]


async def test_a_start_whose_frame_fails_is_rejected_and_the_legs_that_were_written_are_named() -> None:
    robot = await started_and_quiet()
    robot.controller.fail_next(1)
    ack = robot.ask(LEG_3, START)
    assert (ack.accepted, ack.reason, ack.written) == (False, Reason.BUS_FAULT, None)
