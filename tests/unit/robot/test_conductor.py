"""Commands from a received message to frames, answers and reports, in virtual time."""

import asyncio

import pytest

from gateway.model.frames import OneLeg, Op, ServoOp, stop_leg
from gateway.robot.core.message import Verb
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Mode, Reason, WatchdogState
from tests.support.robot import Robot, leg, servo, started_and_quiet

pytestmark = pytest.mark.virtual_time

LEG_3 = keys.leg_command(3)


def moved(op: Op, *angles_deg: float) -> OneLeg:
    first, second, third = (ServoOp(op, round(angle_deg * 100)) for angle_deg in angles_deg)
    return OneLeg(3, (first, second, third))


async def test_a_reset_is_never_taken_from_a_delete_or_a_wildcard() -> None:
    robot = await started_and_quiet()
    robot.put(keys.ESTOP)
    robot.put(keys.RESET, verb=Verb.DELETE)
    robot.put(keys.RESET, expression="hexapod/**/cmd")
    assert robot.mode == Mode.ESTOPPED
    robot.put(keys.RESET, {"estop": 1})
    assert robot.mode == Mode.IDLE


async def test_an_unknown_key_is_rejected_and_the_next_good_command_works() -> None:
    robot = await started_and_quiet()
    ack = robot.ask("hexapod/leg/7/cmd", leg("start", 1, 2, 3))
    assert (ack.accepted, ack.reason, ack.detail) == (False, Reason.INVALID, "leg 7 does not exist; legs are 1 to 6")
    assert robot.frames == []
    assert robot.ask(LEG_3, leg("start", 1, 2, 3)).accepted


@pytest.mark.parametrize(
    ("payload", "more", "reason"),
    [
        (b"{", {}, Reason.MALFORMED),
        (leg("start", 90, 90, 190), {}, Reason.INVALID),
        (leg("start", 90, 90, 90), {"encoding": "text/plain"}, Reason.BAD_ENCODING),
    ],
)
async def test_bad_input_changes_nothing_but_counters(payload: object, more: dict[str, object], reason: Reason) -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, leg("start", 90, 90, 90))
    before = robot.conductor.state()
    ack = robot.ask(LEG_3, payload, **more)
    assert (ack.accepted, ack.reason) == (False, reason)
    assert ack.detail
    after = robot.conductor.state()
    assert after.commands.rejected == before.commands.rejected + 1
    assert [report.servos for report in after.legs] == [report.servos for report in before.legs]
    assert len(robot.frames) == 1


async def test_one_instant_applies_legs_then_leg_then_servo() -> None:
    robot = await started_and_quiet()
    # As the inbox hands them over: in the order of COMMAND_KEYS.
    robot.put_later(keys.LEGS_COMMAND, {"legs": {"3": leg("start", 1, 1, 1)}})
    robot.put_later(LEG_3, leg("start", 2, 2, 2))
    robot.put_later(keys.servo_command(32), servo("start", 3))
    robot.conductor.tick()
    await asyncio.sleep(0.1)
    assert [frame for _, frame in robot.frames] == [moved(Op.START, 1, 1, 1), moved(Op.START, 2, 3, 2)]


async def test_a_deadline_does_not_wait_for_a_tick_that_takes_long() -> None:
    robot = await started_and_quiet(rules={"repeats": 0})
    robot.put(LEG_3, leg("start", 1, 1, 1))
    for _ in range(8):
        robot.put_later(keys.leg_command(4), b"{")
    robot.put_later(keys.leg_command(5), leg("start", 1, 1, 1))
    robot.each_takes_ns = 40_000_000
    robot.conductor.tick()
    stopped_ms, *_, started_ms = (at_ms for at_ms, _ in robot.frames[1:])
    assert robot.frames[1][1] == stop_leg(3)
    assert stopped_ms - robot.frames[0][0] == pytest.approx(280, abs=0.01), "after the seventh of nine messages"
    assert started_ms > stopped_ms


async def test_what_a_deadline_stops_within_a_tick_is_not_started_by_what_the_tick_had_taken() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, leg("start", 1, 1, 1))
    for _ in range(8):
        robot.put_later(keys.leg_command(4), b"{")
    answers = robot.ask_later(LEG_3, leg("start", 2, 2, 2))
    robot.each_takes_ns = 40_000_000
    robot.conductor.tick()
    assert [ack.reason for ack in answers] == [Reason.SERVO_STOPPED]
    assert robot.controller.energised == set()


async def test_two_laptops_on_one_leg_are_both_named() -> None:
    robot = Robot()
    robot.conductor.start()
    robot.put(LEG_3, leg("start", 1, 2, 3, source="anna"))
    robot.put(LEG_3, leg("set", 2, 2, 3, source="anna"))
    assert not robot.events(Kind.SOURCE_CHANGED), "the leg was nobody's before"
    assert robot.conductor.state().legs[2].source == "anna"
    robot.put(LEG_3, leg("set", 3, 2, 3), source="0123abc")
    (event,) = robot.events(Kind.SOURCE_CHANGED)
    assert (event.source, event.detail) == ("0123abc", "leg 3 is commanded by 0123abc, and was by anna")
    assert event.legs == (3,)
    robot.put(LEG_3, {"servos": [{"op": "stop"}] * 3, "source": "ben"})
    assert robot.events(Kind.SOURCE_CHANGED)[-1].detail == "leg 3 is commanded by ben, and was by 0123abc"
    assert [each.source for each in robot.conductor.state().legs] == [None, None, "ben", None, None, None]
    robot.put(LEG_3, leg("start", 1, 2, 3, source="anna"))
    assert len(robot.events(Kind.SOURCE_CHANGED)) == 2, "a stopped leg is taken from nobody"
    await asyncio.sleep(1)
    assert robot.conductor.state().legs[2].source is None, "the watchdog has stopped it"


async def test_rejections_are_told_ten_times_a_second_and_source_and_counted_in_full() -> None:
    robot = await started_and_quiet()
    for _ in range(100):
        robot.put(LEG_3, b"{", source="noisy")
        robot.put(LEG_3, b"{", source="other") if robot.conductor.metrics.rejected.total() == 51 else None
        await asyncio.sleep(0.001)
    assert len([event for event in robot.events() if event.source == "noisy"]) == 10
    assert len([event for event in robot.events() if event.source == "other"]) == 1
    await asyncio.sleep(1)
    robot.put(LEG_3, b"{", source="noisy")
    assert robot.events()[-1].left_out == 90
    assert "90" not in robot.events()[-1].detail
    assert robot.conductor.state().commands.rejected == 102


@pytest.mark.parametrize(("scope", "legs"), [("leg", [(2,), (5,)]), ("robot", [tuple(LEGS), tuple(LEGS)])])
async def test_a_watchdog_event_names_the_legs_that_are_stopped(scope: str, legs: list[tuple[int, ...]]) -> None:
    robot = await started_and_quiet(watchdog={"scope": scope})
    setpoint = {"servos": [servo("start", 90)] * 3}
    robot.put(keys.LEGS_COMMAND, {"legs": {"5": setpoint, "2": setpoint}})
    await asyncio.sleep(1)
    assert [event.legs for event in robot.events(Kind.WATCHDOG_EXPIRED)] == legs


async def test_the_state_says_what_was_last_written() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, leg("start", 1, 2, 3.25))
    await asyncio.sleep(0.1)
    state = robot.conductor.state()
    third = state.legs[2]
    assert (third.leg, third.watchdog) == (3, WatchdogState.ARMED)
    assert third.age_ms == pytest.approx(100)
    assert [(report.id, report.running, report.angle_deg) for report in third.servos] == [
        (31, True, 1.0),
        (32, True, 2.0),
        (33, True, 3.25),
    ]
    assert state.legs[0].age_ms is None
    assert state.commands.accepted == 1
    at_start = 6 * (1 + 3 + 3) + 18  # Stops, their repeats, and what follows them
    assert state.spi.frames == at_start + 1


async def test_an_answer_that_cannot_be_sent_harms_nobody() -> None:
    robot: Robot = await started_and_quiet()
    robot.put(LEG_3, leg("start", 1, 2, 3), verb=Verb.GET, reply=lambda _: None)
    assert robot.controller.energised == {31, 32, 33}


@pytest.mark.virtual_time
@pytest.mark.parametrize(
    "key", ["hexapod/leg/{}/cmd", "hexapod/{}/cmd", "hexapod/" + "x" * 86 + "{}/cmd", "{0}/{0}/cmd"]
)
async def test_a_rejection_repeats_no_token_that_stands_in_a_key(key: str) -> None:
    robot = Robot()
    token = "0123456789abcdef" * 2
    ack = robot.ask(key.format(token), {})
    robot.conductor.answers.reject_unread(key.format(token), None, "nothing reads this key")
    rejections = robot.events(Kind.COMMAND_REJECTED)
    assert len(rejections) == 2
    assert not any(token in report.model_dump_json() for report in (ack, *rejections))
