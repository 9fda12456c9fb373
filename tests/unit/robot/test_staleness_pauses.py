"""Commands that may have waited in a gateway that was stopped itself; and what the gateway says to delayed ones."""

import asyncio

import pytest

from gateway.robot.core.staleness import Staleness
from schemas import keys
from schemas.telemetry import Kind, Reason
from tests.support.delayed import MAX_AGE_MS, MS, Publisher
from tests.support.robot import leg, servo, started_and_quiet


@pytest.fixture
def stopping() -> Staleness:
    """One whose loop turns when the test says so."""
    return Staleness(MAX_AGE_MS)


def turn_until(staleness: Staleness, now_ms: float) -> None:
    for turn_ms in range(0, round(now_ms), 100):
        staleness.turned(turn_ms * MS)


def without_sent_ms(staleness: Staleness, now_ms: float) -> str | None:
    return staleness.too_old("anybody", None, round(now_ms * MS), round(now_ms * MS))


def test_after_a_pause_of_its_own_only_what_is_known_to_be_fresh_is_taken(stopping: Staleness) -> None:
    known, stranger = Publisher(stopping), Publisher(stopping, name="stranger", zero_ms=0)
    turn_until(stopping, 1000)
    assert known.asks(990) is None
    assert without_sent_ms(stopping, 990) is None
    stopping.turned(3000 * MS)
    assert known.arrives(3000, sent_at_ms=1500) is not None
    assert known.asks(3001) is None, "its clock says that it is fresh"
    for at_ms in (3001, 3100, 3199):
        said = stranger.asks(at_ms)
        assert said == without_sent_ms(stopping, at_ms)
        assert said == (
            "the gateway itself was stopped for 2010 ms, so the command may have waited in it; for 200 ms only those "
            "are accepted whose sent_ms shows that they are fresh"
        )
    assert stranger.asks(3201) is None
    assert without_sent_ms(stopping, 3201) is None


def test_a_pause_between_two_commands_of_one_instant_counts_too(stopping: Staleness) -> None:
    """They were read from the rings before it."""
    known = Publisher(stopping)
    turn_until(stopping, 1000)
    assert known.asks(1000) is None
    instant_ns = 1000 * MS
    assert stopping.too_old("anybody", None, 3000 * MS, instant_ns) is not None
    assert stopping.too_old(known.name, known.clock_ms(1000), 3000 * MS, instant_ns) is not None


def test_the_usual_turns_of_the_loop_are_no_pause(stopping: Staleness) -> None:
    for now_ms in (0, 100, 349, 550, 799):
        stopping.turned(now_ms * MS)
        assert without_sent_ms(stopping, now_ms) is None


def test_a_pause_that_is_not_longer_than_what_a_command_may_be_delayed_is_none() -> None:
    staleness = Staleness(2000)
    for now_ms in (0, 2000, 4000):
        staleness.turned(now_ms * MS)
        assert without_sent_ms(staleness, now_ms) is None
    staleness.turned(6001 * MS)
    assert without_sent_ms(staleness, 8001) is not None
    assert without_sent_ms(staleness, 8002) is None


# ---- in the gateway


@pytest.mark.virtual_time
async def test_the_gateway_rejects_what_was_delayed_but_never_a_stop() -> None:
    robot = await started_and_quiet(limits={"max_age_ms": MAX_AGE_MS})
    key = keys.servo_command(32)
    assert robot.ask(key, servo("start", 90, source="laptop", sent_ms=1000)).accepted
    await asyncio.sleep(0.05)
    await asyncio.sleep(0.45)  # half a second after the first
    ack = robot.ask(key, servo("set", 80, source="laptop", sent_ms=1001))
    assert ack.reason == Reason.STALE
    assert ack.detail == "the command was delayed for 499 ms; at most 200 are allowed"
    mixed = leg("start", 1, 2, 3, source="laptop", sent_ms=1001)
    assert robot.ask(keys.leg_command(3), mixed).reason == Reason.STALE
    assert robot.ask(key, servo("start", 80)).accepted, "nothing is known of a command without sent_ms"
    assert robot.ask(key, servo("stop", source="laptop", sent_ms=1001)).accepted
    assert robot.controller.energised == set()


@pytest.mark.virtual_time
async def test_a_reset_that_was_delayed_leaves_no_emergency_stop() -> None:
    robot = await started_and_quiet()
    assert robot.ask(keys.servo_command(32), servo("start", 90, source="laptop", sent_ms=1000)).accepted
    await asyncio.sleep(1)
    assert robot.ask(keys.ESTOP).estop == 1
    delayed = robot.ask(keys.RESET, {"estop": 1, "source": "laptop", "sent_ms": 1100})
    assert delayed.reason == Reason.STALE
    assert robot.mode == "estopped"
    assert robot.ask(keys.RESET, {"estop": 1, "source": "laptop", "sent_ms": 2000}).accepted


@pytest.mark.virtual_time
@pytest.mark.parametrize("between", ["ticks", "messages"])
async def test_a_gateway_that_was_stopped_itself_does_not_execute_what_waited_in_it(between: str) -> None:
    robot = await started_and_quiet(watchdog={"timeout_ms": 10_000})
    key = keys.leg_command(3)
    assert robot.ask(key, leg("start", 1, 2, 3, source="laptop", sent_ms=1000)).accepted
    if between == "ticks":
        robot.sleep_through(2)
    else:
        robot.put_later(keys.leg_command(1), leg("stop"))
        robot.each_takes_ns = 2000 * MS
    robot.put_later(key, leg("set", 4, 5, 6, source="laptop", sent_ms=1010))
    robot.put_later(keys.leg_command(2), leg("start", 4, 5, 6))
    robot.put_later(keys.RESET, {"estop": 0})
    robot.conductor.tick()
    robot.each_takes_ns = 0
    assert robot.controller.energised == {31, 32, 33}
    assert [event.reason for event in robot.events(Kind.COMMAND_REJECTED)] == [Reason.STALE] * 3
    assert robot.ask(keys.leg_command(2), leg("start", 4, 5, 6)).reason == Reason.STALE
    assert robot.ask(key, leg("stop")).accepted
    assert robot.ask(keys.ESTOP).stop_frames == 6
    await asyncio.sleep(0.6)
    assert robot.ask(keys.RESET, {"estop": 1}).accepted
    assert robot.ask(keys.leg_command(2), leg("start", 4, 5, 6)).accepted


@pytest.mark.virtual_time
async def test_without_an_age_limit_a_pause_changes_nothing() -> None:
    robot = await started_and_quiet(limits={"max_age_ms": 0})
    robot.sleep_through(2)
    assert robot.ask(keys.leg_command(2), leg("start", 4, 5, 6)).accepted
