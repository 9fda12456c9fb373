"""Stops to legs at rest (Behaviour 4): a servo that nobody started does not stay on."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Transmit
from gateway.robot.core.leg import Rules
from schemas.robot import LEGS, SERVO_IDS
from tests.support.steps import Steps, leg_to, legs_to, servo_to, staggered


def stopped_too(robot: Steps) -> list[int]:
    """The legs at rest that get a Stop behind the step's first Stops."""
    joining = robot.joining
    stops = [effect for effect in robot.effects if isinstance(effect, Transmit) and effect.frame.is_stop]
    assert stops[len(stops) - len(joining) :] == joining, "first Stops come first"
    return [effect.frame.servos[0][0] // 10 for effect in joining]


# ---- when, and to whom


def test_legs_at_rest_are_stopped_with_a_silent_leg_and_those_that_run_are_not() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(2, "start 90"))
    assert robot.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]
    assert stopped_too(robot) == [3, 4, 5, 6]
    assert robot.running == [21, 22, 23]


def test_while_others_run_each_leg_at_rest_gets_a_stop_every_800_ms() -> None:
    robot = Steps(Rules(repeats=0, timeout_ns=10_000 * NS_PER_MS))
    robot.command(100, legs_to("1", "start 90"))
    robot.command(800, servo_to(21, "start 90"))
    assert robot.due_ms == 900
    assert robot.time(899) == []
    assert robot.time(900) == [f"repeat {number} stop" for number in (3, 4, 5, 6)]
    assert robot.due_ms == 1700


def test_a_service_that_ends_waits_for_no_further_run() -> None:
    robot = Steps(Rules(repeats=0))
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(1, "stop"))
    assert robot.due_ms is not None
    robot.end(300)
    assert robot.due_ms is None


def test_a_start_in_the_step_of_a_round_is_not_undone() -> None:
    robot = Steps()
    robot.command(10, leg_to(1, "start 90"))
    for at_ms in range(200, 800, 200):
        robot.command(at_ms, leg_to(1, "set 90"))
    assert robot.command(810, leg_to(2, "start 90")) == [
        "repeat 3 stop",
        "repeat 4 stop",
        "repeat 5 stop",
        "repeat 6 stop",
        "command 2 start 90",
        "completed 5",
    ]


def test_a_leg_that_waits_to_be_started_gets_none() -> None:
    robot = staggered(50)
    robot.command(100, legs_to("12", "start 90"))
    robot.command(110, (*leg_to(1, "stop"), *leg_to(3, "start 90")))
    assert stopped_too(robot) == [2, 4, 5, 6], "leg 2's start is dropped, and leg 3's waits"


# ---- more runs, once nothing runs


def test_a_round_uses_no_rate_slot_and_the_state_says_what_it_said() -> None:
    robot = Steps()
    robot.command(10, leg_to(2, "start 90"))
    robot.time(260)
    robot.command(300, leg_to(1, "start 90"))
    slots = [each.slots.next_ns for each in robot.supervisor.legs]
    robot.time(550)
    assert stopped_too(robot) == [2, 3, 4, 5, 6]
    assert [each.slots.next_ns for each in robot.supervisor.legs] == slots
    assert [each.watchdog for each in robot.supervisor.legs][:3] == ["expired", "expired", "idle"]


RUN_MS = 1100
REPEATED = [f"repeat {number} stop" for number in LEGS]
SINGLY = [f"repeat {servo_id} stop" for servo_id in SERVO_IDS]


def at_rest() -> Steps:
    """Opened at 0 ms, and nothing is owed any more at 5000 ms."""
    robot = Steps(Rules(repeats=3))
    assert runs_of(robot) == [20, 40, 60, *(60 + RUN_MS * run for run in (1, 2, 3, 4))], "after the Stops at the start"
    return robot


def runs_of(robot: Steps) -> list[float]:
    """Wake it up as it wants, until it wants nothing any more: when all legs got Stops, each servo's own at last."""
    found = []
    words: list[str] = []
    while robot.due_ms is not None:
        due_ms = robot.due_ms
        words = robot.time(due_ms)
        if words in (REPEATED, SINGLY):
            found += [due_ms]
        assert words != SINGLY or robot.due_ms is None
    assert words == SINGLY or robot.supervisor.legs.rest.runs == 0
    return found


@pytest.mark.parametrize("how", ["emergency stop", "stop", "one servo's stop", "silence", "stop-servos", "power"])
def test_three_more_runs_follow_whatever_brings_the_last_leg_to_rest(how: str) -> None:
    robot = at_rest()
    at_ms = 5010.0
    if how == "one servo's stop":
        robot.command(5000, servo_to(11, "start 90"))
        robot.command(at_ms, servo_to(11, "stop"))
    else:
        robot.command(5000, leg_to(1, "start 90"))
        if how == "emergency stop":
            robot.estop(at_ms)
        elif how == "stop":
            robot.command(at_ms, leg_to(1, "stop"))
        elif how == "silence":
            robot.time(at_ms := 5250)
        elif how == "stop-servos":
            robot.outside(at_ms, at_work=True)
        else:
            robot.board(at_ms, doubt="it is not confirmed")
    assert [round(each - at_ms) for each in runs_of(robot)] == [20, 40, 60, 1160, 2260, 3360, 4460]


def test_a_stop_while_they_are_owed_moves_none_and_three_more_are_far_enough_behind_it() -> None:
    robot = at_rest()
    robot.estop(5000)
    for at_ms in (5020, 5040, 5060):
        assert robot.time(at_ms) == REPEATED
    robot.estop(6150)
    assert runs_of(robot) == [6170, 6190, 6210, 7310, 8410, 9510, 10_610], "6160 is among its repeats"
    robot.estop(12_000)
    robot.time(12_020)
    robot.estop(13_000)
    runs = runs_of(robot)
    assert 13_160 in runs, "where it was"
    assert [each for each in runs if each >= 13_060 + 1000] == [14_260, 15_360, 16_460, 17_560]


# ---- nothing that is owed moves to a later time


def test_a_bus_that_opens_again_owes_the_repeats_of_its_own_stops() -> None:
    robot = at_rest()
    robot.estop(5000)
    robot.time(5020)
    robot.fail(5025)
    robot.open(5050)
    assert runs_of(robot)[:3] == [5070, 5090, 5110]
