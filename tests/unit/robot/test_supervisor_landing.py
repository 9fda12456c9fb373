"""Landing: when a leg falls silent, the whole robot goes to its pose, and then gets its Stops. Each step is judged."""

from typing import Any

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.calibration import CalibrationChange
from gateway.model.frames import Op
from gateway.robot.core.events import Announce, Transmit
from gateway.robot.core.leg import Rules
from schemas.telemetry import Kind, Mode, WatchdogState
from tests.support.steps import Steps, all_stopped, leg_to, legs_to, servo_to

TIMEOUT_MS, LANDING_MS = 250, 1000
ENDS_MS = 10 + TIMEOUT_MS + LANDING_MS
"""For a leg that was last heard at 10 ms."""


def landing_steps(**changes: Any) -> Steps:
    """Legs 3 and 4 run since 10 ms, and have been silent since; the pose names two of their servos."""
    rules = {
        "repeats": 0,
        "rest_runs": 0,
        "landing_ns": LANDING_MS * NS_PER_MS,
        "landing_cdeg": {31: 30_00, 42: 100_00},
    }
    steps = Steps(Rules(**{**rules, **changes}))
    steps.command(10, legs_to("34", "start 90"))
    return steps


def until(steps: Steps, at_ms: float) -> dict[int, list[tuple[float, int]]]:
    """Let time pass as the service does, up to `at_ms`: which angle each servo was told, and when."""
    told: dict[int, list[tuple[float, int]]] = {}
    while steps.due_ms is not None and steps.due_ms <= at_ms:
        now_ms = steps.due_ms
        steps.time(now_ms)
        for effect in steps.effects:
            if isinstance(effect, Transmit):
                for servo_id, op in effect.frame.servos:
                    assert op.op in (Op.SET, Op.STOP)
                    if op.op is Op.SET:
                        told.setdefault(servo_id, []).append((now_ms, op.angle_cdeg))
    return told


def test_silence_lands_the_whole_robot_and_then_stops_it() -> None:
    steps = landing_steps()
    assert steps.time(10 + TIMEOUT_MS) == ["announce landing"]
    told = until(steps, ENDS_MS - 1)
    assert [angle for _, angle in told[31]] == sorted((angle for _, angle in told[31]), reverse=True)
    assert told[31][-1][1] == 30_00
    assert 45 <= len(told[31]) <= 50, "one frame in a period"
    assert told[42][-1][1] == 100_00
    assert told.keys() == {31, 42}, "a servo that the pose does not name holds its angle"
    assert steps.running == [31, 32, 33, 41, 42, 43]
    assert steps.due_ms == ENDS_MS
    assert steps.time(ENDS_MS) == [*all_stopped("watchdog"), "announce watchdog_expired"]
    assert steps.only(Announce).legs == (1, 2, 3, 4, 5, 6)
    assert steps.supervisor.mode is Mode.IDLE
    watchdogs = [leg.watchdog for leg in steps.supervisor.legs]
    assert watchdogs == [WatchdogState.EXPIRED if leg in (3, 4) else WatchdogState.IDLE for leg in range(1, 7)]


@pytest.mark.parametrize(("late_ms", "next_ms"), [(0, 300), (5, 300), (15, 300), (16, 301), (20, 320), (65, 365)])
def test_what_a_timer_is_late_does_not_add_up_and_is_not_made_up_for(late_ms: float, next_ms: float) -> None:
    steps = landing_steps()
    steps.time(10 + TIMEOUT_MS)
    assert steps.due_ms == 280
    assert steps.time(280 + late_ms)[0].startswith("watchdog 31 set")
    assert steps.due_ms == next_ms
    assert steps.time(next_ms)[0].startswith("watchdog 31 set")


def test_a_leg_whose_slot_comes_later_keeps_no_other_from_going_on() -> None:
    steps = landing_steps(landing_cdeg={31: 30_00, 42: 90_24})
    steps.time(10 + TIMEOUT_MS)
    assert steps.time(296) == ["watchdog 31 set 88.75"]
    assert steps.time(300) == ["watchdog 42 set 90.01"]


def test_a_second_landing_begins_where_the_servos_are() -> None:
    steps = landing_steps()
    until(steps, ENDS_MS)
    steps.command(2000, legs_to("34", "start 90"))
    steps.time(2000 + TIMEOUT_MS)
    assert steps.time(2000 + TIMEOUT_MS + 500)[0] == "watchdog 31 set 88.75", "and leaps no further after a stall"


def test_a_leg_that_is_still_commanded_lands_too_and_its_commands_are_rejected() -> None:
    steps = landing_steps()
    steps.command(200, leg_to(4, "set 91"))
    steps.time(10 + TIMEOUT_MS)
    assert "rejected 3 landing" in steps.command(300, leg_to(4, "set 92"))
    assert "rejected 4 landing" in steps.command(301, leg_to(5, "start 90"))
    until(steps, ENDS_MS - 1)
    assert steps.command(ENDS_MS, leg_to(4, "set 92"))[-1] == "rejected 5 servo_stopped", "the landing has ended"
    assert steps.running == []
    assert steps.command(ENDS_MS + 2, leg_to(4, "start 92")) == ["command 4 start 92", "completed 6"]


def test_a_stop_stops_its_leg_at_once_and_the_others_go_on() -> None:
    steps = landing_steps()
    steps.time(10 + TIMEOUT_MS)
    assert steps.command(300, leg_to(3, "stop"))[0] == "command 3 stop"
    told = until(steps, ENDS_MS - 1)
    assert 31 not in told
    assert told[42][-1][1] == 100_00


def test_when_all_are_stopped_the_landing_is_over() -> None:
    steps = landing_steps()
    steps.time(10 + TIMEOUT_MS)
    steps.command(300, legs_to("34", "stop"))
    assert steps.due_ms is None
    assert steps.command(301, leg_to(3, "start 90"))[0] == "command 3 start 90"


@pytest.mark.parametrize("at_ms", [10 + TIMEOUT_MS, 500, ENDS_MS - 1, ENDS_MS])
def test_the_emergency_stop_ends_it_at_any_instant(at_ms: float) -> None:
    steps = landing_steps()
    until(steps, at_ms - 0.5)
    assert steps.estop(at_ms) == [*all_stopped("estop"), "announce estop_engaged"]
    assert steps.due_ms is None
    steps.reset(at_ms + 1)
    assert steps.command(at_ms + 2, leg_to(3, "start 90"))[0] == "command 3 start 90"


def test_a_bus_fault_and_the_end_never_land() -> None:
    steps = landing_steps()
    steps.time(10 + TIMEOUT_MS)
    steps.fail(300)
    assert steps.open(400) == [*all_stopped("startup"), "announce bus_recovered"]
    assert steps.due_ms is None
    steps = landing_steps()
    steps.time(10 + TIMEOUT_MS)
    assert steps.end(300) == [*all_stopped("shutdown"), "announce stopping"]


def test_after_a_pause_that_took_as_long_as_the_landing_it_stops_at_once() -> None:
    steps = landing_steps()
    assert steps.time(ENDS_MS)[:2] == ["watchdog 3 stop", "watchdog 4 stop"]


def test_a_late_look_makes_the_landing_no_longer() -> None:
    steps = landing_steps()
    steps.time(ENDS_MS - 100)
    assert not until(steps, ENDS_MS).keys() - {31, 32, 33, 41, 42, 43}
    assert steps.running == []


def test_a_pose_outside_the_joint_limits_is_not_approached() -> None:
    steps = landing_steps(joint_limits_cdeg={31: (80_00, 100_00)})
    told = until(steps, ENDS_MS)
    assert {angle for _, angle in told.get(31, [])} <= {90_00}


def test_a_landing_that_was_due_before_a_new_pose_was_kept_goes_to_the_old_one() -> None:
    steps = landing_steps()
    steps.calibrate(20, CalibrationChange({}, {31: 170_00, 42: 10_00}))
    assert steps.kept(10 + TIMEOUT_MS) == ["announce landing", "announce calibrated", "completed 2"]
    told = until(steps, ENDS_MS - 1)
    assert (told[31][-1][1], told[42][-1][1]) == (30_00, 100_00)


def test_a_limited_speed_holds_in_a_landing() -> None:
    steps = landing_steps(max_speed_cdeg_s={31: 10_00})
    told = until(steps, ENDS_MS)[31]
    assert 80_00 <= told[-1][1] <= 80_40  # 1000 ms of it, at 10 degrees a second


def test_where_nothing_runs_nothing_lands() -> None:
    steps = Steps(Rules(repeats=0, landing_ns=1000 * NS_PER_MS, period_ns=1000 * NS_PER_MS))
    for at_ms in (10, 300, 600):  # three rate slots are kept
        steps.command(at_ms, servo_to(31, "start 90"))
        steps.command(at_ms + 1, servo_to(31, "stop"))
    steps.command(700, servo_to(31, "start 90"))
    assert "announce landing" not in steps.time(700 + TIMEOUT_MS)


def test_the_announcement_says_why_and_how_long() -> None:
    steps = landing_steps()
    steps.time(10 + TIMEOUT_MS)
    assert steps.effects == [
        Announce(
            Kind.LANDING,
            "no command for leg 3 in 250 ms; the robot lands, and is stopped 1000 ms later",
            legs=(1, 2, 3, 4, 5, 6),
        )
    ]
