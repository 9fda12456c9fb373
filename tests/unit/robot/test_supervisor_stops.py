"""The gateway's own Stops: the watchdog, the repeats, the emergency stop."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Announce
from gateway.robot.core.leg import Rules
from schemas.robot import LEGS
from schemas.telemetry import Mode, WatchdogState
from tests.support.steps import Steps, Targets, all_stopped, leg_to, legs_to, servo_to


def watchdog_of(robot: Steps) -> list[WatchdogState]:
    return [each.watchdog for each in robot.supervisor.legs]


IDLE, ARMED, EXPIRED = WatchdogState.IDLE, WatchdogState.ARMED, WatchdogState.EXPIRED

# ---- 4, the watchdog


def test_a_silent_leg_is_stopped() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.due_ms == 350
    assert robot.time(349.999) == []
    assert robot.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]
    assert robot.only(Announce).legs == (1,)
    assert robot.supervisor.mode is Mode.IDLE
    assert robot.supervisor.watchdog.expirations == 1
    assert robot.due_ms is None
    assert watchdog_of(robot) == [EXPIRED, IDLE, IDLE, IDLE, IDLE, IDLE]


@pytest.mark.parametrize(
    "targets",
    [leg_to(1, "start 80"), servo_to(12, "set 80"), legs_to("12", "start 1"), leg_to(1, "stop", "stop", "set 80")],
)
def test_any_accepted_command_that_starts_or_sets_a_servo_of_the_leg_feeds_it(targets: Targets) -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(300, targets)
    assert robot.time(350) == []
    assert "watchdog 1 stop" in robot.time(550)


@pytest.mark.parametrize("targets", [servo_to(12, "stop"), (*servo_to(12, "stop"), *leg_to(2, "start 90"))])
def test_a_stop_for_one_servo_does_not_keep_the_others_running(targets: Targets) -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    for at_ms in range(110, 350, 20):
        robot.command(at_ms, targets)
    assert robot.time(350)[:1] == ["watchdog 1 stop"]
    assert set(robot.running) <= {21, 22, 23}


def test_other_legs_do_not_feed_it() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(300, leg_to(2, "start 90"))
    assert robot.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]
    assert robot.running == [21, 22, 23]


def test_rejected_commands_do_not_feed_it() -> None:
    robot = Steps(Rules(repeats=0, joint_limits_cdeg={11: (0, 90_00)}))
    robot.command(100, servo_to(11, "start 90"))
    assert robot.command(200, servo_to(12, "set 90")) == ["rejected 2 servo_stopped"]
    assert robot.command(300, servo_to(11, "set 91")) == ["rejected 3 joint_limit"]
    assert robot.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]


# ---- repeats


def test_one_silent_leg_stops_all_six_where_the_scope_is_the_robot() -> None:
    robot = Steps(Rules(repeats=0, whole_robot=True))
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(2, "start 90"))
    robot.command(204, leg_to(2, "set 80"))
    assert robot.time(350) == [*all_stopped("watchdog"), "rejected 3 stale", "announce watchdog_expired"]
    assert robot.only(Announce).legs == tuple(LEGS)
    assert watchdog_of(robot) == [EXPIRED, EXPIRED, IDLE, IDLE, IDLE, IDLE]
    assert robot.supervisor.watchdog.expirations == 1


def test_every_stop_is_repeated() -> None:
    robot = Steps(Rules(repeats=2, repeat_interval_ns=20 * NS_PER_MS, rest_runs=0))
    assert robot.due_ms == 20
    assert robot.time(20) == all_stopped("repeat")
    assert robot.time(39) == []
    assert robot.time(40) == all_stopped("repeat")
    assert robot.due_ms is None
    robot.command(100, leg_to(1, "start 90"))
    robot.command(150, servo_to(12, "stop"))
    assert robot.time(170) == ["repeat 12 stop"]
    assert robot.time(190) == ["repeat 12 stop"]
    robot.time(400)
    assert robot.time(420) == all_stopped("repeat"), "of all legs, since none runs any more"


def test_repeats_end_when_the_servo_is_started_again() -> None:
    robot = Steps(Rules(repeats=3))
    assert robot.command(10, servo_to(11, "start 90")) == ["command 11 start 90", "completed 1"]
    assert robot.time(20) == ["repeat 12 stop", "repeat 13 stop", *all_stopped("repeat")[1:]]
    robot.command(40, leg_to(1, "start 90"))
    assert robot.time(60) == all_stopped("repeat")[1:]


# ---- 5, the emergency stop


def test_the_emergency_stop_stops_all_and_latches() -> None:
    robot = Steps()
    robot.command(100, legs_to("135", "start 90"))
    robot.command(101, legs_to("135", "set 80"))
    assert robot.estop(102) == [*all_stopped("estop"), "rejected 2 estopped", "announce estop_engaged"]
    assert robot.supervisor.mode is Mode.ESTOPPED
    for at_ms, targets in ((103, leg_to(1, "start 90")), (104, leg_to(1, "set 90"))):
        assert robot.command(at_ms, targets) == [f"rejected {robot.number} estopped"]
    assert robot.command(105, leg_to(1, "stop")) == ["command 1 stop", "rejected 5 estopped stopped"]
    assert robot.command(106, leg_to(1, "stop", "start 9", "set 9")) == [
        "command 11 stop",
        "rejected 6 estopped stopped",
    ]
    assert robot.time(1000) == []


def test_it_takes_the_place_of_a_watchdogs_stop() -> None:
    robot = Steps()
    robot.command(1, leg_to(1, "start 90"))
    robot.time(251)
    assert watchdog_of(robot)[0] == EXPIRED
    robot.estop(252)
    assert watchdog_of(robot) == [IDLE] * 6


def test_a_reset_leaves_the_latch_and_nothing_moves() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.estop(110)
    assert robot.reset(120) == ["announce estop_reset", "completed 2"]
    assert robot.supervisor.mode is Mode.IDLE
    assert robot.time(400) == []
    assert robot.command(410, leg_to(1, "set 90")) == ["rejected 3 servo_stopped"]


def test_of_one_instant_an_emergency_stop_is_the_newer_however_long_it_takes_to_deal_with_it() -> None:
    robot = Steps()
    robot.instant_ms = 100
    robot.estop(100.5)
    assert robot.reset(101) == ["rejected 1 estopped"]
    robot.instant_ms = 101.5
    assert robot.reset(102) == ["announce estop_reset", "completed 2"]


def test_emergency_stops_are_numbered_and_a_reset_must_name_the_latest() -> None:
    robot = Steps()
    assert robot.supervisor.latch.number == 0
    for number in (1, 2):
        robot.estop(100 + number)
        assert robot.supervisor.latch.number == number
    assert robot.reset(110, newer=-1) == ["rejected 1 estopped"]
    assert robot.detail == "a newer emergency stop was requested: estop is 1, and the latest is 2"
    assert robot.reset(111, newer=1) == ["rejected 2 estopped"]
    assert robot.detail == "no such emergency stop was requested: estop is 3, and the latest is 2"
    assert robot.supervisor.mode is Mode.ESTOPPED
    assert robot.reset(112) == ["announce estop_reset", "completed 3"]
    robot.estop(113)
    assert robot.supervisor.latch.number == 3


def test_a_reset_without_a_number_is_taken_2_s_after_the_latest_emergency_stop() -> None:
    robot = Steps()
    robot.estop(100)
    robot.estop(1000)
    assert robot.reset_without_number(2999.999) == ["rejected 1 estopped"]
    assert robot.detail == (
        "the emergency stop was requested 2.0 s ago; a reset without its number (estop) is accepted after 2 s"
    )
    assert robot.reset_without_number(3000) == ["announce estop_reset", "completed 2"]


def test_a_stop_that_left_ahead_of_its_legs_slot_is_not_in_the_frame_of_that_slot() -> None:
    steps = Steps(Rules(repeats=0))
    steps.command(100, leg_to(3, "start 90"))
    steps.command(101, leg_to(3, "set 85"))
    stopped = steps.command(102, leg_to(3, "set 80", "stop", "stop"))
    assert stopped == ["command 32 stop", "command 33 stop", "completed 2 coalesced"]
    assert steps.time(122) == ["command 31 set 80", "completed 3"]


def test_where_nothing_runs_a_first_stop_of_a_step_is_not_repeated_with_those_that_are_due() -> None:
    robot = Steps(Rules(repeats=1, rest_runs=0))
    robot.command(5000, leg_to(2, "stop"))
    assert robot.command(5020, leg_to(1, "start 90", "stop", "stop")) == [
        "repeat 2 stop",
        "command 1 start 90 | stop | stop",
        "completed 2",
    ]
