"""A robot whose wire can start and stop all servos only, and none alone. Each step is judged by the oracle."""

from typing import Any

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Announce, Command
from gateway.robot.core.leg import Rules
from schemas.telemetry import WatchdogState
from tests.support.steps import Steps, Targets, all_stopped, leg_to, legs_to, servo_to

ALL = "123456"
STARTED = [f"command {leg} start 90" for leg in range(1, 7)]


def whole(**changes: Any) -> Steps:
    """At rest."""
    return Steps(Rules(**{"repeats": 0, "rest_runs": 0, "starts_whole": True, **changes}))


def running(**changes: Any) -> Steps:
    """All legs run since 10 ms."""
    steps = whole(**changes)
    assert steps.command(10, legs_to(ALL, "start 90"), "legs") == [*STARTED, "completed 1"]
    return steps


@pytest.mark.parametrize("targets", [servo_to(11, "start 90"), leg_to(1, "start 90"), legs_to("12345", "start 90")])
def test_a_start_of_a_part_is_rejected_and_says_what_to_send(targets: Targets) -> None:
    steps = whole()
    assert steps.command(10, targets) == ["rejected 1 whole_robot"]
    assert steps.detail == (
        "this robot can only be started as a whole: send one command with a start for each joint of all six legs to "
        "hexapod/legs/cmd"
    )
    assert steps.due_ms is None


@pytest.mark.parametrize(
    "targets", [servo_to(42, "stop"), leg_to(4, "stop"), legs_to("25", "stop"), legs_to(ALL, "stop")]
)
def test_a_stop_of_any_servo_stops_all_six_legs(targets: Targets) -> None:
    steps = running()
    assert steps.command(20, targets) == [*all_stopped("command"), "completed 2"]
    assert steps.running == []
    assert steps.command(30, servo_to(42, "set 80")) == ["rejected 3 servo_stopped"]


@pytest.mark.parametrize("other", ["start 80", "set 80"])
def test_a_command_that_stops_and_moves_stops_and_its_moves_are_dropped(other: str) -> None:
    steps = running()
    assert steps.command(40, leg_to(1, "stop", other, other)) == [
        *all_stopped("command"),
        "rejected 2 whole_robot stopped",
    ]
    assert steps.detail == (
        "this robot only stops as a whole: a Stop in this command stopped it, and its moves are dropped"
    )
    assert not steps.supervisor.legs.due_ns


def test_a_start_waits_for_the_last_legs_rate_slot_and_then_leaves_in_one_step() -> None:
    steps = running()
    steps.command(16, leg_to(4, "set 80"))
    steps.command(22, leg_to(4, "set 70"))
    steps.command(23, leg_to(1, "stop"))
    assert steps.command(24, legs_to(ALL, "start 90"), "legs") == []
    due_ms = steps.due_ms
    assert due_ms == steps.supervisor.legs.by_number[4].slots.next_ns / NS_PER_MS - 60_000
    assert due_ms > 24
    assert steps.time(due_ms - 0.1) == []
    assert steps.time(due_ms) == [*STARTED, "completed 5"]


def test_messages_that_were_lost_stop_all_that_one_of_them_may_have_stopped() -> None:
    steps = running()
    lost = Command(leg_to(2, "stop"), key="leg/2", number=9, lost=True)
    assert steps.take(20, lost) == [*all_stopped("command"), "completed 9"]


def test_one_silent_leg_stops_the_robot_whatever_the_scope_and_the_event_says_why() -> None:
    steps = running(whole_robot=False)
    for leg in "12345":
        steps.command(100, leg_to(int(leg), "set 80"))
    assert steps.time(260) == [*all_stopped("watchdog"), "announce watchdog_expired"]
    assert steps.only(Announce).legs == (1, 2, 3, 4, 5, 6)
    assert steps.only(Announce).detail == (
        "no command for leg 6 in 250 ms; all six legs are stopped, since this robot can only be stopped as a whole"
    )
    assert {leg.watchdog for leg in steps.supervisor.legs} == {WatchdogState.EXPIRED}


def test_starts_one_after_the_other_are_no_rules_of_such_a_robot() -> None:
    with pytest.raises(ValueError, match="cannot start leg by leg"):
        Rules(starts_whole=True, start_pause_ns=1)
