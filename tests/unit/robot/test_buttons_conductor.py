"""Who watches, from the payload on `hexapod/button/cmd` to the answer, the frames, the events and the state."""

import asyncio
from typing import Any

import pytest

from gateway.robot.zenoh_io.proofs import Proofs
from schemas import keys
from schemas.button import ButtonAck
from schemas.robot import LEGS
from schemas.telemetry import ButtonsReport, Cause, Kind, Mode, Reason
from tests.support.robot import Robot, leg, started_and_quiet

LEG_3 = keys.leg_command(3)
START, SET, STOP = leg("start", 90, 90, 90), leg("set", 45, 45, 45), leg("stop")
pytestmark = pytest.mark.virtual_time


async def watched(required: int = 1, **buttons: Any) -> tuple[Robot, ButtonAck]:
    """The kitchen is alive."""
    robot = await started_and_quiet(buttons={"required": required, **buttons}, watchdog={"timeout_ms": 10_000})
    ack = robot.button("register", "kitchen")
    assert robot.button("alive", button=ack.button, count=1).accepted
    return robot, ack


async def test_silence_stops_all_six_legs_and_says_who_was_silent() -> None:
    robot, _ = await watched()
    assert robot.ask(LEG_3, START).accepted
    await asyncio.sleep(0.999)
    before = len(robot.frames)
    assert robot.mode == Mode.ACTIVE
    await asyncio.sleep(0.002)
    assert robot.mode == Mode.IDLE
    assert len(robot.frames) == before + len(LEGS)
    (event,) = robot.events(Kind.BUTTON_SILENT)
    assert (event.source, event.legs) == ("kitchen", tuple(LEGS))
    assert robot.conductor.metrics.frames[Cause.WATCHDOG] == len(LEGS)
    assert robot.conductor.metrics.events == {Kind.STARTED: 1, Kind.BUTTON_REGISTERED: 1, Kind.BUTTON_SILENT: 1}
    assert robot.conductor.reports.state().watchdog.stop_latency_us.max is not None
    assert robot.conductor.reports.state().buttons == ButtonsReport(required=1)


@pytest.mark.parametrize("required", [0, 1, 2])
async def test_so_many_are_required(required: int) -> None:
    robot, _ = await watched(required=required)
    assert robot.ask(LEG_3, START).accepted is (required < 2)


async def test_what_is_rejected_is_told_with_its_reason() -> None:
    robot, ack = await watched()
    again = robot.button("alive", button=ack.button, count=1)
    assert (again.accepted, again.reason) == (False, Reason.STALE)
    assert again.detail
    assert robot.button("alive", button="0" * 32, count=1).reason == Reason.UNKNOWN_BUTTON
    told = [(event.key, event.reason) for event in robot.events(Kind.COMMAND_REJECTED)]
    assert told == [(keys.BUTTON, Reason.STALE), (keys.BUTTON, Reason.UNKNOWN_BUTTON)]
    assert not any(str(ack.button) in event.detail for event in robot.events(Kind.COMMAND_REJECTED))
    assert robot.button("leave", button=ack.button).accepted
    assert robot.conductor.reports.state().buttons.alive == 0


@pytest.mark.parametrize(
    ("payload", "detail"),
    [
        ({"do": "alive", "button": "0" * 32}, "count is missing, or not as docs/interface.md defines it"),
        ({"do": "alive", "button": "0" * 31, "count": 1}, "button is missing, or not as docs/interface.md defines it"),
        ({"do": "alive", "button": "0" * 32, "count": 1.5}, "count is missing, or not as docs/interface.md defines it"),
        ({"do": "alive", "button": "0" * 32, "count": -1}, "count is missing, or not as docs/interface.md defines it"),
        ({"do": "alive", "button": "0" * 32, "count": 2**53 + 1}, "count is missing, or not as"),
        ({"do": "register"}, "source is missing, or not as docs/interface.md defines it"),
        ({"do": "register", "source": "x" * 65}, "source is missing, or not as docs/interface.md defines it"),
        ({"do": "press", "source": "x"}, 'do must be "challenge", "register", "alive" or "leave"'),
        ({"do": "leave", "button": "0" * 32, "why": "x"}, "the payload has a field that is not known here"),
    ],
)
async def test_what_cannot_be_read_changes_nothing(payload: dict[str, Any], detail: str) -> None:
    robot, _ = await watched()
    do = payload.pop("do")
    ack = robot.button(do, **payload)
    assert (ack.accepted, ack.reason) == (False, Reason.INVALID)
    assert str(ack.detail).startswith(detail)
    assert robot.conductor.reports.state().buttons.alive == 1


async def test_without_a_ca_a_challenge_has_no_nonce_and_names_are_taken_as_they_are() -> None:
    robot, _ = await watched()
    ack = robot.button("challenge")
    assert (ack.accepted, ack.nonce) == (True, None)
    assert not Proofs(None, lambda: pytest.fail("no clock is asked")).wanted


@pytest.mark.parametrize(
    ("names", "counts"),
    [((), True), (("kitchen",), True), (("door", "kitchen"), True), (("door",), False), (("button",), False)],
)
async def test_where_names_are_wanted_others_do_not_count(names: tuple[str, ...], counts: bool) -> None:
    """Without certificates nobody has a role, and a person is what stands before the slash."""
    robot = await started_and_quiet(buttons={"required": 1, "names": names})
    ack = robot.button("register", "kitchen/phone")
    alive = robot.button("alive", button=ack.button, count=1)
    assert (alive.accepted, alive.alive, alive.detail is None) == (True, int(counts), counts)
    assert robot.conductor.reports.state().buttons.names == ("kitchen/phone",)
    assert robot.ask(LEG_3, START).accepted is counts
