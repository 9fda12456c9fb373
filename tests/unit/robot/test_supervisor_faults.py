"""Faults of the bus, starts one after the other, the end, and the table of transitions."""

from dataclasses import replace

import pytest

from gateway.allowance import NS_PER_S
from gateway.robot.core.events import (
    BusFailed,
    BusOpened,
    Command,
    EmergencyStop,
    Event,
    Reset,
    ShutDown,
    StoppedOutside,
    TimePassed,
)
from gateway.robot.core.leg import Rules
from gateway.robot.core.legal import IllegalEvent
from schemas.telemetry import Mode
from tests.support.model_check import copied, key, pending
from tests.support.steps import Steps, all_stopped, leg_to, servo_to
from tests.support.transitions import TRANSITIONS

# ---- 6, bus fault


def test_after_a_fault_nothing_is_sent_and_everything_rejected() -> None:
    robot = Steps(Rules(repeats=3))
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 80"))
    assert robot.fail(200) == ["rejected 2 bus_fault", "announce bus_fault"], "nothing goes out that was due at 120"
    assert not pending(robot.supervisor), "nothing is kept of what was answered"
    assert robot.supervisor.mode is Mode.BUS_FAULT
    assert robot.due_ms is None
    for at_ms, word in ((203, "start 90"), (204, "set 90"), (205, "stop")):
        assert robot.command(at_ms, leg_to(1, word)) == [f"rejected {robot.number} bus_fault"]
    assert robot.reset(206) == ["rejected 6 bus_fault"]
    assert robot.time(10_000) == []


def test_a_bus_that_answers_again_stops_all_and_sends_nothing_that_waited() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 80"))
    robot.fail(102)
    assert robot.open(150) == [*all_stopped("startup"), "announce bus_recovered"]
    assert robot.supervisor.mode is Mode.IDLE
    assert robot.running == []
    assert robot.time(1000) == []


def test_an_emergency_stop_during_a_fault_latches() -> None:
    robot = Steps()
    robot.fail(100)
    assert robot.estop(110) == ["announce estop_engaged"]
    assert "follow as soon as it does" in str(robot.effects)
    assert robot.open(200)[:6] == all_stopped("startup")
    assert robot.supervisor.mode is Mode.ESTOPPED


# ---- 7, the end


def test_the_end_stops_all_and_rejects_everything() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 80"))
    assert robot.end(102) == [*all_stopped("shutdown"), "rejected 2 stopping", "announce stopping"]
    assert robot.supervisor.mode is Mode.STOPPING
    assert robot.command(103, leg_to(1, "start 90")) == ["rejected 3 stopping"]
    assert robot.reset(104) == ["rejected 4 stopping"]
    assert robot.estop(105) == [*all_stopped("estop"), "announce estop_engaged"]
    assert robot.time(1000) == []


def test_the_end_during_a_fault_says_that_no_stop_was_sent_until_the_bus_answers() -> None:
    robot = Steps()
    robot.fail(100)
    assert robot.end(110) == ["announce stopping"]
    assert "no Stop can be sent" in str(robot.effects)
    assert robot.open(120)[:6] == all_stopped("startup")
    assert robot.supervisor.mode is Mode.STOPPING


# ---- the table of transitions

EVENTS: dict[type[Event], Event] = {
    Command: Command(servo_to(11, "start 90"), key="leg", number=9),
    Reset: Reset(number=9),
    EmergencyStop: EmergencyStop(),
    BusOpened: BusOpened(),
    BusFailed: BusFailed("EIO"),
    StoppedOutside: StoppedOutside(at_work=True),
    TimePassed: TimePassed(),
    ShutDown: ShutDown(),
}


def robot_in(mode: Mode) -> Steps:
    """A robot in this mode, with as much going on in it as there can be."""
    robot = Steps(Rules(repeats=1), opened=mode is not Mode.STARTING)
    if mode not in (Mode.STARTING, Mode.IDLE):
        robot.command(1, leg_to(1, "start 90"))
        robot.command(2, leg_to(1, "set 80"))
    match mode:
        case Mode.ESTOPPED:
            robot.estop(3)
        case Mode.BUS_FAULT:
            robot.fail(3)
        case Mode.STOPPING:
            robot.end(3)
    assert robot.supervisor.mode is mode
    return robot


@pytest.mark.parametrize("kind", EVENTS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("at_ms", [4, 10_000])
def test_every_event_in_every_mode(mode: Mode, kind: type[Event], at_ms: float) -> None:
    robot = robot_in(mode)
    event = replace(EVENTS[kind])
    if kind in TRANSITIONS[mode]:
        robot.take(at_ms, event)
        assert robot.supervisor.mode in TRANSITIONS[mode][kind]
        return
    untouched = copied(robot.supervisor)
    with pytest.raises(IllegalEvent, match=f"{kind.__name__} while {mode}"):
        robot.take(at_ms, event)
    assert (robot.supervisor.mode, robot.supervisor.due_ns) == (untouched.mode, untouched.due_ns)
    rank = {number: number for number in pending(untouched)}
    assert key(robot.supervisor, NS_PER_S, rank) == key(untouched, NS_PER_S, rank)
