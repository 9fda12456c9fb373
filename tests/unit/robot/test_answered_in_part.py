"""A command of several frames that fails after some were written is answered as what it is, with these legs named."""

import asyncio
from collections.abc import Callable

import pytest

from gateway.robot.core.events import StoppedOutside
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Ack, Kind, Reason
from tests.support.faulty_controller import FaultyController
from tests.support.robot import Robot, leg, servo, started_and_quiet

pytestmark = pytest.mark.virtual_time

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


async def test_a_bus_that_fails_on_the_way() -> None:
    """The batch counts as failed wholly: nobody knows how far it came."""
    robot = await started_and_quiet()
    fail_the_third(robot)
    ack = robot.ask(keys.LEGS_COMMAND, {"legs": {str(number): leg("start", 90, 90, 90) for number in LEGS}})
    assert (ack.accepted, ack.reason, ack.written) == (False, Reason.BUS_FAULT, None)
    assert robot.controller.energised == {11, 12, 13, 21, 22, 23}


class ThirdFails(FaultyController):
    """Of the transfers from now on the third fails."""

    _count = 0

    def take(self, data: bytes) -> None:
        self._count += 1
        if self._count == 3:
            self.fail_next(1)
        super().take(data)


def fail_the_third(robot: Robot) -> None:
    robot.controller = ThirdFails(robot.settings.spi.framing, clock=robot.now_ns)
    robot.conductor.bus.open()


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
