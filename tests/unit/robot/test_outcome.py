"""What became of a step's requests: a fault rejects the commands whose frames failed, and no others."""

import asyncio
from collections.abc import Callable

import pytest

from gateway.model.frames import stop_leg
from gateway.robot.core.events import (
    Command,
    Completed,
    Effect,
    Rejected,
    Reset,
    StoppedOutside,
    Transmit,
    Verdict,
    results,
)
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Ack, Cause, Kind, Mode, Reason
from tests.support.robot import LEG_1, LEG_3, START, Robot, leg, servo, started_and_quiet

pytestmark = pytest.mark.virtual_time

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


# ---- A command of several frames that fails after some were written is answered as what it is, with these legs named


STAGGER_MS = 200
WRITTEN = [1, 2]
"""The legs that are started by the time of `LATER_S`."""
LATER_S = 0.25
LEG_RUNS = {number: [10 * number + joint for joint in (1, 2, 3)] for number in LEGS}


async def half_started(**sections: dict[str, object]) -> tuple[Robot, list[Ack]]:
    """Six legs that are started one after the other, in the middle of it."""
    robot = await started_and_quiet(
        limits={"start_stagger_ms": STAGGER_MS}, watchdog={"timeout_ms": 5000}, rules={"repeats": 0}, **sections
    )
    answers = robot.get(keys.LEGS_COMMAND, {"legs": {str(number): leg("start", 90, 90, 90) for number in LEGS}})
    await asyncio.sleep(LATER_S)
    assert answers == []
    return robot, answers


def stop_a_leg_that_waits(robot: Robot) -> None:
    robot.put(keys.leg_command(6), leg("stop"))


def stop_a_leg_that_runs(robot: Robot) -> None:
    robot.put(keys.leg_command(2), leg("stop"))


def acquire_the_lease(robot: Robot) -> None:
    assert robot.lease("acquire", "bert").accepted


def stop_outside(robot: Robot) -> None:
    robot.conductor._step(StoppedOutside(at_work=True))


def emergency_stop(robot: Robot) -> None:
    robot.put(keys.ESTOP)


def end(robot: Robot) -> None:
    robot.conductor.shut_down()


@pytest.mark.parametrize(
    ("cause", "reason", "run_on"),
    [
        (stop_a_leg_that_waits, Reason.SERVO_STOPPED, [1, 2]),
        (stop_a_leg_that_runs, Reason.SERVO_STOPPED, [1]),
        (acquire_the_lease, Reason.NOT_HOLDER, [1, 2]),
        (stop_outside, Reason.SERVO_STOPPED, []),
        (emergency_stop, Reason.ESTOPPED, []),
        (end, Reason.STOPPING, []),
    ],
)
async def test_the_rest_is_withdrawn_and_the_answer_names_what_was_written(
    cause: Callable[[Robot], None], reason: Reason, run_on: list[int]
) -> None:
    robot, answers = await half_started()
    cause(robot)
    (ack,) = answers
    assert (ack.accepted, ack.reason, ack.written) == (False, reason, WRITTEN)
    assert ack.detail is not None
    assert ack.detail.endswith("; what it asks of legs 1, 2 had been written before")
    await asyncio.sleep(2 * len(LEGS) * STAGGER_MS / 1000)
    assert robot.controller.energised == {servo_id for number in run_on for servo_id in LEG_RUNS[number]}
    (rejected,) = robot.events(Kind.COMMAND_REJECTED)
    assert rejected.detail == ack.detail


async def test_a_leg_s_command_whose_stop_went_ahead_of_its_start() -> None:
    """Its Stop waits for no rate slot, and what waits for one is ended by somebody else's Stop."""
    robot = await started_and_quiet(limits={"leg_rate_hz": 1})
    assert robot.ask(keys.leg_command(1), leg("start", 90, 90, 90)).accepted
    mixed = {"servos": [servo("stop"), servo("set", 80), servo("set", 80)]}
    answers = robot.get(keys.leg_command(1), mixed)
    assert answers == []
    robot.put(keys.ESTOP)
    (ack,) = answers
    assert (ack.accepted, ack.written) == (False, [1])
    assert ack.detail is not None
    assert ack.detail.endswith("; what it asks of leg 1 had been written before")
