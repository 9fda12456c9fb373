"""What became of a step's requests: a fault rejects the commands whose frames failed, and no others."""

import asyncio
from collections.abc import Callable
from typing import Final

import pytest

from gateway.model.frames import stop_leg
from gateway.robot.core import events
from gateway.robot.runtime.executor import Outcome
from gateway.robot.spi import Sent
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Cause, Kind, Mode, Reason
from tests.support.robot import LEG_1, LEG_3, START, Robot, leg, servo, started_and_quiet

pytestmark = pytest.mark.virtual_time


async def test_stops_count_that_have_the_cause_and_were_received() -> None:
    sent = [Sent(0, 0, 0, received=received) for received in (True, False, True)]
    causes = (Cause.ESTOP, Cause.ESTOP, Cause.REPEAT)
    frames = [events.Transmit(stop_leg(1), cause) for cause in causes]
    assert Outcome(written=list(zip(frames, sent, strict=True))).stop_frames(Cause.ESTOP) == 1


async def test_a_reset_whose_step_cannot_write_repeated_stops_is_accepted() -> None:
    robot = await started_and_quiet()
    robot.put(keys.ESTOP)
    robot.sleep_through(0.03)  # the next step writes repeated Stops, which fail
    robot.controller.fail_where(lambda _: True)
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
    assert str(answers[0].detail).startswith("the frame could not be written: ")


async def test_a_rejected_command_does_not_claim_stops_that_were_not_written() -> None:
    robot = await started_and_quiet()
    robot.controller.fail_where(lambda _: True)
    ack = robot.ask(LEG_3, {"servos": [servo("stop"), servo("set", 80), servo("set", 80)]})
    assert (ack.reason, ack.stopped) == (Reason.SERVO_STOPPED, None)


# ---- A command of several frames that fails after some were written is answered as what it is, with these legs named


STAGGER_MS = 200

CAUSES: Final[dict[str, tuple[Callable[[Robot], object], Reason, list[int]]]] = {
    # what ends the command, why its rest is rejected, and which legs run on
    "a Stop of a leg that waits": (
        lambda robot: robot.put(keys.leg_command(6), leg("stop")),
        Reason.SERVO_STOPPED,
        [1, 2],
    ),
    "a Stop of a leg that runs": (lambda robot: robot.put(keys.leg_command(2), leg("stop")), Reason.SERVO_STOPPED, [1]),
    "another holder of the lease": (lambda robot: robot.lease("acquire", "bert"), Reason.NOT_HOLDER, [1, 2]),
    "stop-servos": (
        lambda robot: robot.conductor._step(events.StoppedOutside(at_work=True)),
        Reason.SERVO_STOPPED,
        [],
    ),
    "an emergency stop": (lambda robot: robot.put(keys.ESTOP), Reason.ESTOPPED, []),
    "the end": (lambda robot: robot.conductor.shut_down(), Reason.STOPPING, []),
}


@pytest.mark.parametrize(("cause", "reason", "run_on"), CAUSES.values(), ids=CAUSES)
async def test_the_rest_is_withdrawn_and_the_answer_names_what_was_written(
    cause: Callable[[Robot], object], reason: Reason, run_on: list[int]
) -> None:
    robot = await started_and_quiet(
        limits={"start_stagger_ms": STAGGER_MS}, watchdog={"timeout_ms": 5000}, rules={"repeats": 0}
    )
    answers = robot.get(keys.LEGS_COMMAND, {"legs": {str(number): leg("start", 90, 90, 90) for number in LEGS}})
    await asyncio.sleep(0.25)
    assert answers == [], "legs 1 and 2 are started, and no others"
    cause(robot)
    (ack,) = answers
    assert (ack.accepted, ack.reason, ack.written) == (False, reason, [1, 2])
    assert ack.detail is not None
    assert ack.detail.endswith("; the command's frames for legs 1 and 2 were already written")
    await asyncio.sleep(2 * len(LEGS) * STAGGER_MS / 1000)
    assert robot.controller.energised == {servo_id for servo_id in SERVO_IDS if servo_id // 10 in run_on}
    (rejected,) = robot.events(Kind.COMMAND_REJECTED)
    assert rejected.detail == ack.detail
