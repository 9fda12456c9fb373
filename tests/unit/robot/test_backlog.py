"""Starts without `sent_ms` that a link has held back: of a burst, a leg that does not run takes none (Behaviour 19)."""

import asyncio
import json
import random
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.frames import Op
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.events import Command
from gateway.robot.core.leg import Rules
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Reason
from tests.support.robot import Robot, leg
from tests.support.steps import Steps, leg_to, legs_to

pytestmark = pytest.mark.virtual_time

PERIOD_MS = 20.0
STALLS_S = tuple(0.5 + 9.5 * number / 49 for number in range(50))


class WaitingRobot(Robot):
    """With the service's own rules."""

    start_wait_ns = START_WAIT_NS


class Message(NamedTuple):
    """What a program puts, and when (ms)."""

    at_ms: float
    key: str
    payload: bytes
    encoding: str


def python(payload: dict[str, Any]) -> bytes:
    return json.dumps(payload).encode()


def rust(payload: dict[str, Any]) -> bytes:
    """As serde_json writes it: without spaces."""
    return json.dumps(payload, separators=(",", ":")).encode()


def c(payload: dict[str, Any]) -> bytes:
    """As printf writes it: angles with two decimals, a key on each line."""
    lines = json.dumps(payload, indent=1).encode()
    return lines.replace(b'": 90', b'": 90.00')


LANGUAGES = {"Python": (python, "application/json"), "Rust": (rust, "zenoh/bytes"), "C": (c, "application/json")}


def starts_then_sets(language: str, seconds: float, number: int = 3, offset_ms: float = 0.0) -> Iterator[Message]:
    """A leg's stream as most write it: one start, then a set every 20 ms."""
    write, encoding = LANGUAGES[language]
    for turn in range(round(seconds * 1000 / PERIOD_MS)):
        payload = leg("set" if turn else "start", 90, 90, 90)
        yield Message(offset_ms + turn * PERIOD_MS, keys.leg_command(number), write(payload), encoding)


def starts_always(language: str, seconds: float) -> Iterator[Message]:
    """A stream that says start each time, since a start sets what runs."""
    write, encoding = LANGUAGES[language]
    for turn in range(round(seconds * 1000 / PERIOD_MS)):
        yield Message(turn * PERIOD_MS, keys.leg_command(3), write(leg("start", 90, 90, 90)), encoding)


def starts_anew(language: str, seconds: float) -> Iterator[Message]:
    """One that begins again every second: its start stands among its sets."""
    for second in range(round(seconds) + 1):
        yield from starts_then_sets(language, 1.0, offset_ms=1000.0 * second)


def six_in_turn(language: str, seconds: float) -> Iterator[Message]:
    """Six legs, one every 20 ms, each time as a start."""
    write, encoding = LANGUAGES[language]
    for turn in range(round(seconds * 1000 / PERIOD_MS)):
        yield Message(turn * PERIOD_MS, keys.leg_command(1 + turn % 6), write(leg("start", 90, 90, 90)), encoding)


def one_start(language: str, seconds: float) -> Iterator[Message]:
    """A single start; then nothing."""
    yield from starts_then_sets(language, min(seconds, PERIOD_MS / 1000))


def six_streams(language: str, seconds: float) -> Iterator[Message]:
    """Six legs, a start and then sets, one leg after the other in each 20 ms."""
    streams = [starts_then_sets(language, seconds, number, number * 3.0) for number in LEGS]
    yield from sorted(message for stream in streams for message in stream)


def made(robot_class: type[Robot] = WaitingRobot) -> Robot:
    robot = robot_class()
    robot.conductor.start()
    robot.conductor.announce_start()
    return robot


def moving(robot: Robot, since_ms: float = 0.0) -> list[float]:
    """When frames that move something were written."""
    return [at_ms for at_ms, frame in robot.frames if not frame.is_stop and at_ms >= since_ms]


def now_ms(robot: Robot) -> float:
    return robot.now_ns() / NS_PER_MS


async def deliver(robot: Robot, messages: list[Message], chance: random.Random) -> None:
    """At once, as a link does that comes back: in ticks of some messages, within some ms."""
    left = list(messages)
    while left:
        for message in left[: chance.randint(1, 12)]:
            robot.put_later(message.key, message.payload, encoding=message.encoding)
            left.remove(message)
        robot.conductor.tick()
        await asyncio.sleep(chance.uniform(0, 0.002))


async def stalled(robot: Robot, stall_s: float, chance: random.Random) -> list[float]:
    """A program drives, its link stalls, the program dies, and the link delivers what it holds. What moves then?"""
    style = chance.choice([starts_always, starts_anew, six_in_turn])
    language = chance.choice(list(LANGUAGES))
    for message in starts_always(language, chance.uniform(0, 0.2)):
        robot.put(message.key, message.payload, encoding=message.encoding)
        await asyncio.sleep(PERIOD_MS / 1000)
    await asyncio.sleep(stall_s)
    back_ms = now_ms(robot)
    await deliver(robot, list(style(language, stall_s)), chance)
    await asyncio.sleep(1)
    return moving(robot, back_ms)


async def test_fifty_stalls_of_half_a_second_to_ten_start_nothing() -> None:
    for number, stall_s in enumerate(STALLS_S):
        robot = made()
        assert await stalled(robot, stall_s, random.Random(number)) == [], f"{stall_s:.1f} s"  # noqa: S311
        robot.conductor.close()


async def test_without_the_wait_they_would() -> None:
    """The harness's other robots take a start at once."""
    began = 0
    for number, stall_s in enumerate(STALLS_S):
        robot = made(Robot)
        began += bool(await stalled(robot, stall_s, random.Random(number)))  # noqa: S311
        robot.conductor.close()
    assert began == len(STALLS_S)


ORDINARY = (starts_then_sets, starts_always, one_start, six_in_turn, six_streams)


async def test_two_hundred_ordinary_programs_in_three_languages_are_not_rejected() -> None:
    """Each message comes up to 15 ms late, as over Wi-Fi, and in order."""
    for number in range(200):
        chance = random.Random(number)  # noqa: S311
        robot = made()
        style, language = ORDINARY[number % len(ORDINARY)], list(LANGUAGES)[number % len(LANGUAGES)]
        begun_ms = arrives_ms = now_ms(robot)
        first_ms: dict[str, float] = {}
        for message in style(language, 1.0):
            arrives_ms = max(arrives_ms, begun_ms + message.at_ms + chance.uniform(0, 15))
            await asyncio.sleep(max(0.0, round((arrives_ms - now_ms(robot)) / 1000, 5)))
            first_ms.setdefault(message.key, now_ms(robot))
            robot.put(message.key, message.payload, encoding=message.encoding)
        await asyncio.sleep(0.1)
        assert not robot.events(Kind.COMMAND_REJECTED), f"{style.__name__} in {language}"
        assert robot.conductor.state().commands.rejected == 0
        begins_ms = {frame.leg: at_ms for at_ms, frame in reversed(robot.frames) if not frame.is_stop}
        for key, came_ms in first_ms.items():
            assert 0 <= begins_ms[int(key.split("/")[2])] - came_ms <= PERIOD_MS
        robot.conductor.close()


# ---- one rule at a time

WAIT_MS = START_WAIT_NS / NS_PER_MS
RULES = Rules(repeats=0, rest_runs=0, start_wait_ns=START_WAIT_NS)


def test_a_lone_start_leaves_within_one_slot_with_the_newest_angle() -> None:
    robot = Steps(RULES)
    assert robot.command(100, leg_to(1, "start 90")) == []
    assert robot.command(110, leg_to(1, "set 80")) == ["completed 1 coalesced"]
    assert robot.due_ms == 100 + WAIT_MS
    assert robot.time(100 + WAIT_MS) == ["command 1 start 80", "completed 2"]


def test_the_fourth_message_in_one_slot_is_a_burst_and_no_start_of_it_is_ever_sent() -> None:
    robot = Steps(RULES)
    for at_ms in (100, 101, 102):
        robot.command(at_ms, leg_to(1, "start 90"))
    assert robot.command(103, leg_to(1, "start 90")) == ["rejected 3 stale", "rejected 4 stale"]
    assert robot.due_ms is None
    assert robot.command(200, leg_to(1, "start 90")) == ["rejected 5 stale"]
    assert robot.command(353, leg_to(1, "start 90")) == [], "the watchdog's time has passed without a burst"
    assert robot.time(353 + WAIT_MS) == ["command 1 start 90", "completed 6"]


def test_sets_are_of_the_burst_too_and_a_start_before_them_is_dropped() -> None:
    robot = Steps(RULES)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 90"))
    robot.command(102, leg_to(1, "set 90"))
    assert robot.command(103, leg_to(1, "set 90")) == ["rejected 3 stale", "rejected 4 servo_stopped"]


def test_other_keys_are_not_concerned_and_neither_is_a_leg_that_runs() -> None:
    robot = Steps(RULES)
    robot.command(50, leg_to(1, "start 90"))
    robot.time(50 + WAIT_MS)
    robot.take(100, Command(leg_to(2, "start 90"), key="another", number=99))
    for at_ms in (101, 102, 103, 104, 105):
        assert "rejected" not in " ".join(robot.command(at_ms, leg_to(1, "start 90")))
    assert "command 2 start 90" in robot.time(100 + WAIT_MS)


def test_a_stop_of_a_burst_is_a_stop() -> None:
    robot = Steps(RULES)
    for at_ms in (100, 101, 102, 103):
        robot.command(at_ms, leg_to(1, "start 90"))
    mixed = (*leg_to(1, "start 90"), *leg_to(2, "stop"))
    assert robot.command(104, mixed) == ["command 2 stop", "rejected 5 stale stopped"]
    assert robot.command(105, leg_to(1, "stop")) == ["command 1 stop", "completed 6"]


def test_a_start_of_all_legs_waits_for_each_that_does_not_run() -> None:
    robot = Steps(RULES)
    robot.command(100, legs_to("12", "start 90"))
    assert robot.time(100 + WAIT_MS) == ["command 1 start 90", "command 2 start 90", "completed 1"]


async def test_the_answer_says_why() -> None:
    robot = made()
    await asyncio.sleep(1)
    asked = [robot.ask_later(keys.leg_command(3), leg("start", 90, 90, 90)) for _ in range(5)]
    robot.conductor.tick()
    assert [answers[-1].reason for answers in asked][-1] is Reason.STALE
    assert "send sent_ms" in str(asked[-1][-1].detail)
    assert all(frame.is_stop for _, frame in robot.frames)


async def test_with_sent_ms_a_start_leaves_at_once() -> None:
    robot = made()
    answers = robot.get(keys.leg_command(3), leg("start", 90, 90, 90, sent_ms=1.0))
    assert answers[0].accepted
    assert [op.op for _, op in robot.frames[-1][1].servos] == [Op.START] * 3
