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
from tests.support.steps import Steps, all_stopped, leg_to, legs_to, servo_to, staggered
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


@pytest.mark.parametrize("opened", [True, False])
def test_a_fault_is_announced_once(opened: bool) -> None:
    robot = Steps(opened=opened)
    assert robot.fail(100) == ["announce bus_fault"]
    assert robot.fail(200) == []


def test_the_latch_stays_through_a_fault() -> None:
    robot = Steps()
    robot.estop(100)
    robot.fail(110)
    assert robot.open(200)[:6] == all_stopped("startup")
    assert robot.supervisor.mode is Mode.ESTOPPED
    assert robot.command(210, leg_to(1, "start 90")) == ["rejected 1 estopped"]


def test_an_emergency_stop_during_a_fault_latches() -> None:
    robot = Steps()
    robot.fail(100)
    assert robot.estop(110) == ["announce estop_engaged"]
    assert "follow as soon as it does" in str(robot.effects)
    assert robot.open(200)[:6] == all_stopped("startup")
    assert robot.supervisor.mode is Mode.ESTOPPED


# ---- 7, the end


def test_an_emergency_stop_before_the_bus_was_ever_open_latches() -> None:
    robot = Steps(opened=False)
    assert robot.estop(0) == ["announce estop_engaged"]
    assert robot.open(1) == all_stopped("startup")
    assert robot.supervisor.mode is Mode.ESTOPPED


def test_legs_are_energised_with_a_pause_between_them() -> None:
    robot = staggered()
    assert robot.command(100, legs_to("123", "start 90"), "legs") == ["command 1 start 90"]
    assert robot.due_ms == 150
    assert robot.time(149) == []
    assert robot.time(150) == ["command 2 start 90"]
    assert robot.time(200) == ["command 3 start 90", "completed 1"]


def test_those_that_run_are_not_held_back() -> None:
    robot = staggered()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(2, "start 90"))
    assert robot.command(121, leg_to(1, "start 80")) == ["command 1 start 80", "completed 3"]
    assert robot.running == [11, 12, 13]


@pytest.mark.parametrize("stopped", ["1", "2", "6"])
def test_a_stop_anywhere_ends_the_queue(stopped: str) -> None:
    robot = staggered()
    robot.command(100, legs_to("123", "start 90"), "legs")
    told = robot.command(110, legs_to(stopped, "stop"))
    assert told[0] == f"command {stopped} stop"
    assert set(told[1:]) == {"rejected 1 servo_stopped", "completed 2"}
    assert robot.time(150) == []
    assert robot.time(200) == []


def test_a_watchdogs_stop_ends_the_queue() -> None:
    robot = staggered(400)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(2, "start 90"))
    assert robot.time(350) == ["watchdog 1 stop", "rejected 2 servo_stopped", "announce watchdog_expired"]
    assert robot.time(500) == []


def test_a_leg_that_waits_and_is_not_heard_is_rejected() -> None:
    robot = staggered(400)
    robot.command(100, legs_to("12", "start 90"), "legs")
    assert robot.time(350)[:3] == ["watchdog 1 stop", "watchdog 2 stop", "rejected 1 stale"]
    assert robot.time(500) == []


def test_a_leg_that_waits_and_is_heard_is_energised_in_its_turn() -> None:
    robot = staggered(400)
    robot.command(100, legs_to("12", "start 90"), "legs")
    for at_ms in (200, 300, 400):
        robot.command(at_ms, legs_to("12", "start 80"), "legs")
    assert robot.time(500) == ["command 2 start 80", "completed 4"]


def test_a_command_that_starts_one_leg_and_stops_another_does_not_reject_itself() -> None:
    robot = staggered()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(110, leg_to(2, "start 90") + leg_to(3, "stop"), "legs") == ["command 3 stop"]
    assert robot.time(150) == ["command 2 start 90", "completed 2"]


def test_a_set_keeps_the_start_that_waits_although_a_stop_for_another_leg_comes_with_it() -> None:
    robot = staggered()
    robot.command(100, legs_to("1234", "start 90"), "legs")
    told = robot.command(110, leg_to(2, "stop") + leg_to(3, "set 80"), "legs")
    assert told == ["command 2 stop", "rejected 1 servo_stopped"]
    assert robot.time(150) == ["command 3 start 80", "completed 2"]
    assert robot.time(200) == []


def test_a_start_goes_out_at_once_where_the_stop_that_comes_with_it_ends_the_queue_before_it() -> None:
    robot = staggered(4)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "stop"))
    robot.command(104, legs_to("12", "start 90"), "legs")
    told = robot.command(104.5, leg_to(1, "stop") + leg_to(2, "start 80"), "legs")
    assert told == ["command 1 stop", "completed 3 coalesced", "command 2 start 80", "completed 4"]


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


def test_the_stops_of_the_end_are_repeated() -> None:
    robot = Steps(Rules(repeats=1))
    robot.end(100)
    assert robot.time(120) == all_stopped("repeat")
    assert robot.due_ms is None


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
