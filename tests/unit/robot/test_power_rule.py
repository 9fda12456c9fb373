"""What a power board allows: nothing starts that it does not feed, and what it feeds no longer is stopped.

Each step is judged by the oracle.
"""

from typing import Any

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.frames import SETS, STARTS
from gateway.robot.core.events import (
    Announce,
    BusOpened,
    Command,
    Completed,
    PowerSeen,
    Rejected,
    Reset,
    TimePassed,
    Transmit,
)
from gateway.robot.core.latch import Latch
from gateway.robot.core.leg import Rules
from gateway.robot.core.power_rule import PowerRule
from gateway.robot.core.supervisor import Supervisor
from schemas.telemetry import Mode
from tests.support.steps import Steps, all_stopped, leg_to, legs_to, servo_to


def fed(**changes: Any) -> Steps:
    """Leg 3 runs since 10 ms, on a robot whose board has answered at 5 ms."""
    steps = Steps(Rules(**{"repeats": 0, "rest_runs": 0, "power": True, **changes}))
    steps.board(5)
    steps.command(10, leg_to(3, "start 90"))
    steps.board(10)
    return steps


# ---- starts


def test_nothing_starts_before_the_board_has_answered() -> None:
    steps = Steps(Rules(repeats=0, power=True))
    assert steps.command(10, leg_to(3, "start 90")) == ["rejected 1 no_power"]
    assert steps.detail == "the power board does not answer"
    assert steps.board(20) == []
    assert steps.command(30, leg_to(3, "start 90")) == []
    assert steps.board(40) == ["command 3 start 90", "completed 2"]


def test_a_start_waits_until_its_servos_are_fed_and_its_watchdog_with_it() -> None:
    steps = Steps(Rules(repeats=0, power=True))
    steps.board(5)
    assert steps.command(10, leg_to(3, "start 90")) == []
    assert steps.running == []
    assert steps.board(500, fed=[31, 33]) == [], "all of a command start together"
    assert steps.command(600, leg_to(3, "set 80")) == ["completed 1 coalesced"]
    assert steps.board(1000) == ["command 3 start 80", "completed 2"], "the newest target"
    assert steps.time(1249) == []
    assert steps.time(1250) == ["watchdog 3 stop", "announce watchdog_expired"]


def test_a_start_that_nobody_feeds_ends_after_1_8_s_whatever_else_is_sent() -> None:
    steps = Steps(Rules(repeats=0, power=True))
    steps.board(5)
    steps.command(10, leg_to(3, "start 90"))
    steps.command(1700, leg_to(3, "set 80"))
    assert steps.time(1809) == []
    assert steps.time(1810) == ["watchdog 3 stop", "rejected 2 no_power"]
    assert steps.detail == "the power board has not confirmed that it is fed"
    assert steps.board(1900) == []


def test_a_servo_that_waits_for_its_supply_delays_no_other_of_its_leg() -> None:
    steps = Steps(Rules(repeats=0, power=True))
    steps.board(5)
    steps.command(10, servo_to(31, "start 90"))
    steps.board(20)
    assert steps.command(100, servo_to(32, "start 45")) == []
    assert steps.command(150, servo_to(31, "set 91")) == ["command 31 set 91", "completed 3"]
    assert steps.board(200) == ["command 32 start 45", "completed 2"]
    assert steps.time(400) == ["watchdog 3 stop", "announce watchdog_expired"], "watched since the set"


def test_what_was_fed_before_a_stop_is_not_fed_behind_it() -> None:
    steps = fed()
    steps.command(20, leg_to(3, "stop"))
    assert steps.command(30, leg_to(3, "start 90")) == []
    assert steps.board(90) == ["command 3 start 90", "completed 3"]


def test_nothing_lands_where_the_last_servo_was_stopped_in_the_same_step() -> None:
    """The start that nobody fed ends in the step in which the board falls silent."""
    steps = Steps(Rules(repeats=0, power=True, landing_ns=500 * NS_PER_MS, timeout_ns=5000 * NS_PER_MS))
    steps.board(5)
    steps.command(10, servo_to(31, "start 90"))
    steps.board(20, fed=[31])
    steps.command(30, servo_to(32, "start 90"))
    steps.command(40, servo_to(41, "start 90"))
    found = steps.board(30 + 1800, alive=False)
    assert found[0] == "watchdog 3 stop"
    assert "watchdog 4 stop" in found
    assert "announce landing" not in found


@pytest.mark.parametrize("how", ["stop", "estop"])
def test_a_stop_ends_a_start_that_waits_for_its_supply(how: str) -> None:
    steps = Steps(Rules(repeats=0, power=True))
    steps.board(5)
    steps.command(10, leg_to(3, "start 90"))
    assert steps.estop(20) if how == "estop" else steps.command(20, leg_to(3, "stop"))
    assert steps.board(30) == []
    assert steps.running == []


def test_a_robot_whose_supply_starts_a_servo_goes_from_the_angle_that_was_on_the_wire() -> None:
    robot = Supervisor(Rules(repeats=0, power=True, angles_first=True, max_speed_cdeg_s={31: 100_00}))
    robot.step(BusOpened(), 0)
    robot.step(PowerSeen(alive=True), 0)
    robot.step(Command(((31, STARTS[90_00]),), number=1), 10 * NS_PER_MS)
    assert robot.to_feed() == {31: 90_00}
    robot.step(Command(((31, SETS[45_00]),), number=2), 100 * NS_PER_MS)
    assert robot.to_feed() == {31: 90_00}, "as long as the start waits"
    (start,) = robot.step(PowerSeen(alive=True, fed=frozenset({31})), 200 * NS_PER_MS)
    assert isinstance(start, Transmit)
    ((_, op),) = start.frame.servos
    assert op == STARTS[90_00], "no jump to 45"
    robot.step(TimePassed(), 220 * NS_PER_MS)
    assert robot.legs.servos[31].angle_cdeg == 88_00, "a step of its speed"
    assert robot.to_feed() == {31: None}


def test_without_a_board_nothing_waits_for_one() -> None:
    steps = Steps(Rules(repeats=0))
    assert steps.command(10, leg_to(3, "start 90")) == ["command 3 start 90", "completed 1"]


def test_what_the_board_blocks_does_not_start_and_all_else_does() -> None:
    steps = fed()
    assert steps.board(20, refused="12 21") == []
    assert steps.command(30, leg_to(1, "start 90")) == ["rejected 2 no_power"]
    assert steps.detail == "servo 12 is not fed: overcurrent"
    assert steps.command(40, servo_to(11, "start 90")) == []
    assert steps.board(45, refused="12 21") == ["command 11 start 90", "completed 3"]
    assert steps.command(50, leg_to(3, "set 80")) == ["command 3 set 80", "completed 4"]
    steps.board(60)
    assert steps.command(70, servo_to(12, "start 90")) == []
    assert steps.board(80) == ["command 12 start 90", "completed 5"]


def test_a_stop_and_a_reset_need_no_board() -> None:
    steps = fed()
    steps.estop(20)
    steps.board(30, alive=False)
    assert steps.command(35, leg_to(3, "stop")) == ["command 3 stop", "rejected 2 estopped stopped"]
    assert steps.reset(40) == ["announce estop_reset", "completed 3"]
    assert steps.command(50, leg_to(3, "stop"))[0] == "command 3 stop"
    assert steps.command(60, leg_to(3, "start 90")) == ["rejected 5 no_power"]


# ---- what runs


def test_a_leg_with_a_servo_that_is_not_fed_any_more_is_stopped_and_the_others_go_on() -> None:
    steps = fed()
    steps.command(15, leg_to(4, "start 90"))
    steps.board(16)
    assert steps.board(20, lost=(32,)) == ["watchdog 3 stop"]
    assert steps.running == [41, 42, 43]
    assert steps.board(30) == []
    assert steps.running == [41, 42, 43], "fed again, it starts by a command only"
    assert steps.command(40, leg_to(3, "set 80")) == ["rejected 3 servo_stopped"]
    assert steps.command(50, leg_to(3, "start 80")) == []
    assert steps.board(60) == ["command 3 start 80", "completed 4"]


def test_where_the_robot_stops_as_one_a_servo_that_is_lost_stops_all() -> None:
    steps = Steps(Rules(repeats=0, power=True, whole_robot=True))
    steps.board(5)
    steps.command(10, legs_to("123456", "start 90"))
    steps.board(15)
    assert steps.board(20, lost=(32,)) == all_stopped("watchdog")
    assert steps.running == []


def test_a_start_that_waits_for_a_servo_that_is_now_blocked_is_never_sent() -> None:
    steps = fed(period_ns=1000 * NS_PER_MS)
    steps.command(20, leg_to(3, "stop"))
    assert steps.command(30, leg_to(3, "start 90")) == []
    assert steps.board(40, refused="31") == ["watchdog 3 stop", "rejected 3 no_power"]
    assert steps.time(1100) == []
    assert steps.running == []


def test_a_servo_that_does_not_run_is_no_news() -> None:
    steps = fed()
    assert steps.board(20, lost=(11,), refused="11") == []
    assert steps.running == [31, 32, 33]


def test_all_is_stopped_when_the_board_does_not_answer() -> None:
    steps = fed()
    assert steps.board(20, alive=False) == all_stopped("watchdog")
    assert steps.board(30, alive=False) == [], "once"
    assert steps.command(40, leg_to(3, "start 90")) == ["rejected 2 no_power"]


def test_where_a_landing_is_configured_a_silent_board_makes_it_land() -> None:
    steps = fed(landing_ns=1000 * NS_PER_MS)
    assert steps.board(20, alive=False) == ["announce landing"]
    assert (
        steps.only(Announce).detail == "the power board does not answer; the robot lands, and is stopped 1000 ms later"
    )
    assert steps.board(30) == [], "what lands is not turned round"
    assert steps.command(40, leg_to(3, "set 80")) == ["rejected 2 landing"]
    assert steps.time(1020) == [*all_stopped("watchdog"), "announce watchdog_expired"]


def test_doubt_stops_all_legs_and_ends_a_landing() -> None:
    steps = fed(landing_ns=1000 * NS_PER_MS)
    steps.board(20, alive=False)
    assert steps.board(30, doubt="servo 11 is not off") == all_stopped("watchdog")
    assert steps.running == []
    assert steps.time(1020) == []


def test_news_that_comes_with_the_watchdog_keeps_no_leg_running() -> None:
    steps = fed()
    assert "watchdog 3 stop" in steps.board(260)
    assert steps.running == []


def test_the_last_servo_of_the_last_leg_is_stopped_like_any() -> None:
    steps = fed()
    steps.command(15, leg_to(6, "start 90"))
    steps.board(16)
    assert steps.board(20, lost=(63,)) == ["watchdog 6 stop"]


def test_doubt_that_comes_with_the_watchdog_stops_each_leg_once() -> None:
    steps = fed()
    assert steps.board(300, doubt="servo 11 is not off") == all_stopped("watchdog")
    assert steps.announced == []


def test_at_a_bus_at_fault_and_at_the_end_the_board_changes_nothing_that_is_sent() -> None:
    steps = fed()
    steps.fail(20)
    assert steps.board(30, alive=False, doubt="servo 11 is not off") == []
    assert steps.open(40) == [*all_stopped("startup"), "announce bus_recovered"]
    assert steps.command(50, leg_to(3, "start 90")) == ["rejected 2 no_power"], "what it said is kept"
    steps.end(60)
    assert steps.board(70, doubt="servo 11 is not off") == []
    assert steps.supervisor.mode is Mode.STOPPING


# ---- a reset that may be older than the emergency stop


def test_what_the_board_says_before_the_bus_is_open_is_no_mistake() -> None:
    steps = Steps(Rules(repeats=0, power=True), opened=False)
    assert steps.board(0) == []
    steps.open(10)
    assert steps.command(20, leg_to(3, "start 90")) == []
    assert steps.board(30) == ["command 3 start 90", "completed 1"]


def test_an_emergency_stop_of_the_same_instant_comes_as_ever() -> None:
    steps = fed()
    steps.instant_ms = 20
    steps.board(20, lost=(31,))
    assert steps.estop(21) == [*all_stopped("estop"), "announce estop_engaged"]


def test_the_supply_stands_in_the_way_of_moves_only_while_it_has_a_reason() -> None:
    without, supply = PowerRule(Rules()), PowerRule(Rules(power=True))
    assert (without.alive, without.closed) == (True, False)
    assert (supply.alive, supply.closed) == (False, True)


@pytest.mark.parametrize(
    ("names", "age_ms", "why"),
    [
        (3, 1, None),
        (3, 0, "the emergency stop was engaged in the same instant"),
        (2, 1, "a newer emergency stop was requested: estop is 2, and the latest is 3"),
        (4, 1, "no such emergency stop was requested: estop is 4, and the latest is 3"),
        (None, 2000, None),
        (
            None,
            1999,
            "the emergency stop was requested 2.0 s ago; a reset without its number (estop) is accepted after 2 s",
        ),
    ],
)
def test_a_reset_leaves_the_emergency_stop_that_it_was_certainly_sent_after(
    names: int | None, age_ms: int, why: str | None
) -> None:
    rules = Rules(unnumbered_reset_ns=2000 * NS_PER_MS)
    legs, latch = Supervisor(rules).legs, Latch(rules)
    latch.number, latch.since_ns = 3, 5 * NS_PER_MS
    legs.begin(latch.since_ns + age_ms * NS_PER_MS)
    last = latch.take(Reset(estop=names), 0, legs)[-1]
    assert (last.detail if isinstance(last, Rejected) else None) == why


def test_without_an_emergency_stop_no_reset_is_too_old() -> None:
    for estop in (None, 7):
        reset = Reset(estop=estop)
        assert Latch(Rules()).take(reset, 0, Supervisor(Rules()).legs) == [Completed(reset)]


def test_a_start_that_is_not_fed_is_stopped_ahead_of_a_landing() -> None:
    """Its leg is not what the robot lands for, and stands on nothing."""
    steps = fed(landing_ns=500 * NS_PER_MS, feed_ns=240 * NS_PER_MS)
    steps.command(20, leg_to(1, "start 90"))
    assert steps.time(261)[:1] == ["watchdog 1 stop"]
    assert steps.supervisor.legs.landing is not None
