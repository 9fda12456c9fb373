"""`stop-servos` beside a running gateway: what the supervisor makes of Stops that it did not send."""

from gateway.robot.core.leg import Rules
from schemas.telemetry import Mode
from tests.support.steps import Steps, all_stopped, leg_to, legs_to, servo_to


def test_all_count_as_stopped_and_get_a_stop_from_here_too() -> None:
    robot = Steps()
    robot.command(100, legs_to("36", "start 90"))
    robot.command(101, leg_to(3, "set 80"))
    assert robot.outside(102, at_work=True) == [
        *all_stopped("repeat"),
        "rejected 2 servo_stopped",
        "announce stopped_outside",
    ]
    assert robot.running == []
    assert robot.supervisor.mode is Mode.IDLE
    assert robot.due_ms is None, "there is nothing to watch any more"


def test_starts_and_sets_are_rejected_until_it_has_ended_and_stops_are_taken() -> None:
    robot = Steps()
    robot.outside(100, at_work=True)
    assert robot.command(110, leg_to(1, "start 90")) == ["rejected 1 servo_stopped"]
    assert "once it has ended" in str(robot.effects)
    assert robot.command(111, servo_to(11, "set 90")) == ["rejected 2 servo_stopped"]
    assert robot.command(112, leg_to(1, "stop")) == ["command 1 stop", "completed 3"]
    assert robot.outside(120, at_work=False) == []
    assert robot.command(130, servo_to(11, "set 90")) == ["rejected 4 servo_stopped"], "it does not run"
    assert robot.command(131, leg_to(1, "start 90")) == ["command 1 start 90", "completed 5"]


def test_it_is_announced_once_and_again_the_next_time() -> None:
    robot = Steps()
    assert "announce stopped_outside" in robot.outside(100, at_work=True)
    assert robot.outside(200, at_work=True) == all_stopped("repeat")
    robot.outside(300, at_work=False)
    assert "announce stopped_outside" in robot.outside(400, at_work=True)


def test_the_stops_are_repeated_although_the_program_has_ended() -> None:
    robot = Steps(Rules(repeats=2, rest_runs=0))
    for at_ms in (20, 40):
        robot.time(at_ms)
    robot.outside(100, at_work=True)
    robot.outside(105, at_work=False)
    assert robot.time(120) == all_stopped("repeat")
    assert robot.time(140) == all_stopped("repeat")
    assert robot.due_ms is None


def test_beside_a_bus_fault_nothing_is_sent_until_the_bus_answers() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.fail(110)
    assert robot.outside(120, at_work=True) == ["announce stopped_outside"]
    assert robot.open(130)[:6] == all_stopped("startup")
    assert robot.command(140, leg_to(1, "start 90")) == ["rejected 2 servo_stopped"]
