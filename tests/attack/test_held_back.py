"""A stream that a link holds back, and then delivers at once, goes on; and no Stop among what was held back is lost."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.client import Client, leg_payload, legs_payload
from schemas import keys
from schemas.telemetry import Kind
from tests.support.cut_link import CutLink
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events

POSE = (90, 45, 120)
TRIES = 15
RATE_HZ = 50
"""`limits.leg_rate_hz`, by default."""


class HeldBack:
    """A gateway, and a laptop behind a link that can hold back what it sends."""

    def __init__(self, folder: Path, stack: ExitStack, timeout_ms: float) -> None:
        settings: dict[str, dict[str, Any]] = {"watchdog": {"timeout_ms": timeout_ms}}
        self.gateway = stack.enter_context(Gateway(folder, settings))
        self.link = stack.enter_context(CutLink(self.gateway.endpoint))
        self.laptop = stack.enter_context(Client(self.link.endpoint, source="laptop"))
        self.watcher = stack.enter_context(self.gateway.client())
        self.events: Heard[Any] = events(self.watcher)

    def deliver_at_once(self, messages: Sequence[tuple[str, Mapping[str, Any]]]) -> None:
        """The laptop sends these, and nothing of it arrives before the last is sent."""
        self.link.hold()
        for key, payload in messages:
            # Not `Client.publish`: which drops what its own full queue has no room for.
            self.laptop.session.put(
                key, json.dumps(payload), express=True, congestion_control=zenoh.CongestionControl.BLOCK
            )
        self.link.fix()
        self.laptop.state()  # on the same link, behind all that was held back

    def reported(self, kind: Kind) -> list[Any]:
        return [event for event in self.events.all if event.kind == kind]


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def setpoint(key: str) -> dict[str, Any]:
    return legs_payload("set", {3: POSE}) if key == keys.LEGS_COMMAND else leg_payload("set", POSE)


@pytest.mark.full
@pytest.mark.parametrize(
    ("stream_hz", "key", "timeout_ms"),
    [
        (RATE_HZ, keys.LEGS_COMMAND, 250),
        (2 * RATE_HZ, keys.leg_command(3), 250),
        (4 * RATE_HZ, keys.LEGS_COMMAND, 400),
        (4 * RATE_HZ, keys.leg_command(3), 400),
    ],
)
def test_a_stream_that_was_held_back_goes_on(
    tmp_path: Path, stack: ExitStack, stream_hz: int, key: str, timeout_ms: int
) -> None:
    """As many messages as a stream sends in 90 ms, 150 ms, and up to the watchdog's time."""
    robot = HeldBack(tmp_path, stack, timeout_ms)
    for held_ms in [90, 150, timeout_ms - 1] * (TRIES // 3):
        assert robot.watcher.start_leg(3, *POSE).accepted
        count = math.ceil(stream_hz * held_ms / 1000)
        robot.deliver_at_once([(key, setpoint(key))] * count)
    assert not robot.reported(Kind.OVERFLOW)


@pytest.mark.parametrize("key", [keys.LEGS_COMMAND, keys.leg_command(3)])
def test_no_stop_among_what_was_held_back_is_lost(tmp_path: Path, stack: ExitStack, key: str) -> None:
    """Wherever it is among them, it stops the leg: what comes after it only sets, and so starts nothing."""
    robot = HeldBack(tmp_path, stack, 400)
    count = 50
    stop = legs_payload("stop", {3: ()}) if key == keys.LEGS_COMMAND else leg_payload("stop")
    for place in range(0, count, 3):
        assert any(robot.watcher.start_leg(3, *POSE).accepted for _ in range(100))
        messages = [(key, setpoint(key))] * count
        messages[place] = (key, stop)
        robot.deliver_at_once(messages)
        assert not robot.laptop.set_leg(3, *POSE, check=False).accepted, f"it runs, and the {place}th was a Stop"
    assert not robot.reported(Kind.OVERFLOW)


def test_more_than_any_stream_sends_is_an_overflow_which_stops_the_leg_and_is_told_as_that(
    tmp_path: Path, stack: ExitStack
) -> None:
    robot = HeldBack(tmp_path, stack, 250)
    key = keys.LEGS_COMMAND
    for _ in range(TRIES):
        assert any(robot.watcher.start_leg(3, *POSE).accepted for _ in range(100))
        robot.deliver_at_once([(key, setpoint(key))] * 1000)
        if robot.reported(Kind.OVERFLOW):
            break
    event = robot.events.wait(lambda event: event.kind == Kind.OVERFLOW)
    assert (event.reason, event.key, event.legs, event.source) == ("overflow", key, (3,), None)
    assert "somebody" not in event.detail
