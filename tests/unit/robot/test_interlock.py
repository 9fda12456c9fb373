"""A rule is one file and one line: here is one that nobody has, "controller too hot: stop", and what it then does."""

from typing import Any

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.frames import STARTS, servo_ids_of
from gateway.robot.core import supervisor
from gateway.robot.core.events import (
    Announce,
    BusOpened,
    Command,
    Effect,
    EmergencyStop,
    Event,
    PowerSeen,
    Rejected,
    Reset,
    TimePassed,
    Transmit,
)
from gateway.robot.core.interlock import Down, Interlock, Why
from gateway.robot.core.leg import Rules
from gateway.robot.core.legal import IllegalEvent
from gateway.robot.core.legs import Legs
from gateway.robot.core.supervisor import ORDER, Supervisor
from schemas.telemetry import Kind, Mode, Reason

# ---- its file


class Heat(PowerSeen):
    """The controller's temperature; no event of the gateway's own."""

    limit_deg = 80

    def __init__(self, heat_deg: int) -> None:
        super().__init__(alive=True)
        self.heat_deg = heat_deg


class TooHot(Interlock[Heat]):
    """Nothing runs on a controller that is too hot, and no reset leaves an emergency stop."""

    takes = (Heat,)
    bars = (Command, Reset)
    hot = Reason.NO_POWER, "the controller is too hot"

    def why_not(self, request: Any, legs: Legs) -> Why:  # noqa: ARG002
        return self.hot

    def take(self, event: Heat, now_ns: int, legs: Legs) -> list[Effect]:  # noqa: ARG002
        before, self.closed = self.closed, event.heat_deg > Heat.limit_deg
        self.down = Down(self.hot[1], now_ns, *self.hot) if self.closed else None
        return [Announce(Kind.POWER_FAULT, self.hot[1])] if self.closed and not before else []


# ----


@pytest.fixture(autouse=True)
def _one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "ORDER", (*ORDER, TooHot))


class Hot:
    """A robot with that rule, whose leg 3 runs since 10 ms. (The oracle of other tests does not know the rule.)"""

    def __init__(self, **rules: Any) -> None:
        self.supervisor = Supervisor(Rules(repeats=0, rest_runs=0, **rules))
        self.supervisor.step(BusOpened(), 0)
        self.number = 0
        assert self.start(10) is None

    def take(self, at_ms: float, event: Event) -> list[Effect]:
        return self.supervisor.step(event, round(at_ms * NS_PER_MS))

    def start(self, at_ms: float) -> str | None:
        """Why leg 3 does not start; None: it does."""
        self.number += 1
        targets = tuple((servo_id, STARTS[90_00]) for servo_id in servo_ids_of(3))
        return _why_rejected(self.take(at_ms, Command(targets, number=self.number, source="anna")))

    def reset(self, at_ms: float) -> str | None:
        self.number += 1
        return _why_rejected(self.take(at_ms, Reset(number=self.number, estop=1)))


def _why_rejected(effects: list[Effect]) -> str | None:
    return next((each.detail for each in effects if isinstance(each, Rejected)), None)


def told(effects: list[Effect]) -> list[str]:
    return [each.detail for each in effects if isinstance(each, Announce)]


def stopped(effects: list[Effect]) -> list[int]:
    return [each.frame.leg for each in effects if isinstance(each, Transmit) and each.frame.is_stop]


def test_it_stops_what_runs_before_it_says_so() -> None:
    robot = Hot()
    assert robot.take(11, Heat(80)) == []
    effects = robot.take(12, Heat(81))
    assert (len(stopped(effects)), told(effects)) == (6, ["the controller is too hot"])
    assert isinstance(effects[-1], Announce)
    assert robot.supervisor.mode is Mode.IDLE


def test_nothing_starts_and_nothing_resets_until_it_is_cool() -> None:
    robot = Hot()
    robot.take(11, EmergencyStop())
    robot.take(12, Heat(90))
    assert robot.reset(3000) == TooHot.hot[1]
    robot.take(3001, Heat(20))
    assert robot.reset(3002) is None
    robot.take(3003, Heat(90))
    assert robot.start(3004) == TooHot.hot[1]
    robot.take(3005, Heat(20))
    assert robot.start(3006) is None


def test_where_a_landing_is_configured_the_robot_lands() -> None:
    robot = Hot(landing_ns=100 * NS_PER_MS)
    effects = robot.take(12, Heat(90))
    assert (stopped(effects), told(effects)[0]) == (
        [], "the controller is too hot; the robot lands, and is stopped 100 ms later"
    )  # fmt: skip
    assert len(stopped(robot.take(112, TimePassed()))) == 6


def test_its_event_comes_at_any_time_and_that_of_no_rule_never() -> None:
    closed = Supervisor(Rules())
    assert told(closed.step(Heat(90), 1)) == ["the controller is too hot"]
    with pytest.raises(IllegalEvent):
        closed.step(Foreign(alive=True), 2)


class Foreign(PowerSeen):
    """An event that no rule takes."""
