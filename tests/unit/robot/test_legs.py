"""What must hold for each joint alone, for the queue of starts, and in an instant in which time passes."""

import pytest

from gateway.robot.core.leg import Rules
from gateway.robot.core.pacing import NS_PER_MS
from schemas.telemetry import Mode, WatchdogState
from tests.support.steps import Steps, leg_to, legs_to, servo_to

JOINTS = pytest.mark.parametrize("joint", [1, 2, 3])


def staggered(pause_ms: int) -> Steps:
    return Steps(Rules(repeats=0, start_pause_ns=pause_ms * NS_PER_MS))


# ---- each joint


@JOINTS
def test_a_single_running_joint_is_activity(joint: int) -> None:
    robot = Steps()
    robot.command(100, servo_to(10 + joint, "start 90"))
    assert robot.supervisor.mode is Mode.ACTIVE


@JOINTS
def test_a_single_pending_joint_is_sent_in_its_rate_slot(joint: int) -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(101, servo_to(10 + joint, "set 80")) == []
    assert robot.due_ms == 105
    assert robot.time(105) == [f"command {10 + joint} set 80", "completed 2"]


@JOINTS
def test_a_single_joint_waits_to_be_energised_like_a_leg(joint: int) -> None:
    robot = staggered(50)
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(110, servo_to(20 + joint, "start 90")) == []
    assert robot.due_ms == 150
    assert robot.time(150) == [f"command {20 + joint} start 90", "completed 2"]


# ---- the queue of starts


def test_a_leg_that_need_not_be_energised_any_more_keeps_nobody_off() -> None:
    robot = staggered(50)
    robot.command(100, servo_to(22, "start 90"))
    assert robot.command(110, servo_to(21, "start 90")) == []
    assert robot.command(112, leg_to(3, "start 90")) == []
    robot.command(115, servo_to(21, "stop") + servo_to(22, "set 80"))
    assert robot.due_ms == 150
    assert robot.time(150) == ["command 3 start 90", "completed 3"]


def test_a_leg_whose_start_was_dropped_keeps_nobody_off() -> None:
    robot = staggered(50)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(110, leg_to(2, "start 90"))
    assert "rejected 2 estopped" in robot.estop(120)
    robot.reset(130)
    assert robot.command(200, leg_to(3, "start 90"))[0] == "command 3 start 90"


# ---- the watchdog, as the state shows it


def test_every_silent_leg_is_counted() -> None:
    robot = Steps()
    robot.command(100, legs_to("134", "start 90"))
    robot.time(350)
    assert robot.supervisor.expirations == 3


def test_a_leg_is_shown_as_expired_until_it_is_started_or_stopped_as_a_whole() -> None:
    robot = Steps()
    first = robot.supervisor.legs.by_number[1]
    for word, shown in (("stop", WatchdogState.IDLE), ("start 90", WatchdogState.ARMED)):
        robot.command(1000, leg_to(1, "start 90"))
        robot.time(1250)
        assert robot.command(1300, servo_to(12, "stop"))[0] == "command 12 stop"
        assert first.watchdog is WatchdogState.EXPIRED, "one servo says nothing of the leg"
        robot.command(1310, leg_to(1, word))
        assert first.watchdog is shown
        robot.command(1320, leg_to(1, "stop"))


# ---- Stops that come with moves


def test_a_stop_that_comes_with_moves_is_repeated_like_any_other() -> None:
    robot = Steps(Rules(repeats=2))
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(130, leg_to(1, "stop", "set 80", "set 80"))[-2:] == [
        "command 1 stop | set 80 | set 80",
        "completed 2",
    ]
    assert "repeat 11 stop" in robot.time(150)
    assert "repeat 11 stop" in robot.time(170)


def test_a_stream_above_the_rate_that_keeps_a_servo_stopped_leaves_it_to_the_repeats() -> None:
    robot = Steps(Rules(repeats=3))
    robot.command(100, leg_to(1, "start 90"))
    assert "command 11 stop" in robot.command(101, leg_to(1, "stop", "set 80", "set 80"))
    assert "command 11 stop" not in robot.command(102, leg_to(1, "stop", "set 70", "set 70"))
    assert "repeat 11 stop" in robot.time(121)


# ---- a fault


def test_a_bus_that_was_never_open_is_at_fault_and_told() -> None:
    robot = Steps(opened=False)
    assert robot.fail(0) == ["announce bus_fault"]
    assert robot.fail(10) == []


# ---- an instant in which time passes: what was collected together has no order, however long it takes to deal with it


def test_a_start_does_not_overtake_a_stop_of_its_instant_that_comes_with_moves() -> None:
    robot = Steps()
    robot.command(99, leg_to(1, "start 90"))
    robot.instant_ms = 100
    robot.command(101, leg_to(1, "stop", "set 80", "set 80"), "put legs")
    assert robot.command(102, servo_to(11, "start 10"), "put leg/1") == ["rejected 3 servo_stopped"]
    assert robot.command(103, servo_to(11, "start 10"), "put legs") == [], "of one channel it is newer: it is pending"


def test_a_start_does_not_undo_the_watchdogs_stop_of_its_instant() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.instant_ms = 349
    assert robot.command(351, leg_to(1, "start 90"), "put leg/1") == [
        "watchdog 1 stop",
        "announce watchdog_expired",
        "rejected 2 servo_stopped",
    ]
    assert robot.command(352, leg_to(1, "start 90"), "put leg/1") == ["rejected 3 servo_stopped"]


def test_a_stop_of_all_legs_is_seen_on_those_that_the_command_before_it_did_not_move() -> None:
    robot = Steps()
    robot.command(100, legs_to("12", "start 90"))
    robot.command(130, servo_to(11, "set 91"))
    robot.estop(140)
    robot.reset(141)
    assert robot.supervisor.mode is Mode.IDLE
    assert robot.due_ms is None
