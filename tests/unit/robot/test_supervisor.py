"""Commands: which are accepted, as a whole or not at all, and when their frames go out."""

import pytest

from gateway.robot.core.leg import Rules
from schemas.robot import SERVO_IDS
from schemas.telemetry import Mode, WatchdogState
from tests.support.steps import Steps, all_stopped, leg_to, legs_to, servo_to, staggered

# ---- 1, start; 2, start before set


def test_the_start_stops_all_six_legs() -> None:
    robot = Steps(opened=False)
    before = robot.supervisor.mode
    assert before is Mode.STARTING
    assert {leg.watchdog for leg in robot.supervisor.legs} == {WatchdogState.IDLE}
    assert robot.open(0) == all_stopped("startup")
    assert robot.supervisor.mode is Mode.IDLE
    assert robot.due_ms is None


def test_a_start_energises_and_a_set_moves() -> None:
    robot = Steps()
    assert robot.command(1, leg_to(1, "start 90")) == ["command 1 start 90", "completed 1"]
    assert robot.supervisor.mode is Mode.ACTIVE
    assert robot.running == [11, 12, 13]
    assert robot.command(30, leg_to(1, "set 45.5")) == ["command 1 set 45.5", "completed 2"]
    assert robot.command(60, servo_to(12, "set 1")) == ["command 12 set 1", "completed 3"]


@pytest.mark.parametrize("servo_id", SERVO_IDS)
def test_a_set_is_rejected_where_nothing_was_started(servo_id: int) -> None:
    robot = Steps()
    assert robot.command(1, servo_to(servo_id, "set 90")) == ["rejected 1 servo_stopped"]
    assert robot.running == []


def test_a_set_is_rejected_after_every_kind_of_stop() -> None:
    for stop in ("command", "watchdog", "estop", "fault"):
        robot = Steps()
        robot.command(1, leg_to(1, "start 90"))
        match stop:
            case "command":
                robot.command(30, leg_to(1, "stop"))
            case "watchdog":
                robot.time(251)
            case "estop":
                robot.estop(30)
                robot.reset(31)
            case "fault":
                robot.fail(30)
                robot.open(50)
        assert robot.command(300, leg_to(1, "set 90"))[-1].endswith("servo_stopped"), stop
        assert robot.command(310, leg_to(1, "start 90"))[0] == "command 1 start 90", stop


def test_one_set_to_a_stopped_servo_rejects_the_whole_command() -> None:
    robot = Steps()
    robot.command(1, servo_to(11, "start 90"))
    assert robot.command(30, leg_to(1, "set 80", "start 80", "set 80")) == ["rejected 2 servo_stopped"]
    assert robot.detail == "servo 13 does not run; start it before you set it"
    assert robot.command(60, legs_to("23", "start 80") + servo_to(41, "set 1")) == ["rejected 3 servo_stopped"]
    assert robot.running == [11]


def test_a_set_may_follow_a_start_that_waits() -> None:
    robot = Steps()
    robot.command(1, servo_to(11, "start 90"))
    assert robot.command(2, servo_to(12, "start 90")) == []
    assert robot.command(3, servo_to(12, "set 45")) == ["completed 2 coalesced"]
    assert robot.time(21) == ["command 12 start 45", "completed 3"]


# ---- 3, the rate limit


def test_an_angle_outside_a_joints_limits_rejects_the_whole_command() -> None:
    robot = Steps(Rules(repeats=0, joint_limits_cdeg={12: (20_00, 160_00)}))
    assert robot.command(1, leg_to(1, "start 10")) == ["rejected 1 joint_limit"]
    assert "servo 12 may go from 20 to 160 degrees; 10 is outside" in str(robot.effects)
    assert robot.command(2, legs_to("21", "start 160.01")) == ["rejected 2 joint_limit"]
    assert robot.running == []
    assert robot.command(3, leg_to(1, "start 20")) == ["command 1 start 20", "completed 3"]
    assert robot.command(30, servo_to(12, "set 160")) == ["command 12 set 160", "completed 4"]
    assert robot.command(60, servo_to(11, "set 180")) == ["command 11 set 180", "completed 5"]
    assert robot.command(61, leg_to(1, "stop")) == ["command 1 stop", "completed 6"], "a stop has no angle"


def without_slots() -> Steps:
    """Leg 1 runs and has used up all its rate slots; the next comes at 120 ms."""
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    for at_ms in (105, 110):
        assert robot.command(at_ms, leg_to(1, "set 90"))[0] == "command 1 set 90"
    return robot


def test_what_comes_sooner_waits_and_only_the_newest_is_sent() -> None:
    robot = without_slots()
    assert robot.command(112, leg_to(1, "set 80")) == []
    assert robot.due_ms == 120
    assert robot.command(115, leg_to(1, "set 70")) == ["completed 4 coalesced"]
    assert robot.command(117, leg_to(1, "set 60")) == ["completed 5 coalesced"]
    assert robot.time(119) == []
    assert robot.time(120) == ["command 1 set 60", "completed 6"]
    assert robot.time(140) == []


def test_a_command_comes_just_when_another_legs_slot_does() -> None:
    robot = without_slots()
    robot.command(112, leg_to(1, "set 80"))
    assert robot.command(120, leg_to(2, "start 90"))[:3] == ["command 2 start 90", "completed 5", "command 1 set 80"]
    assert robot.due_ms == 112 + 250, "nothing waits any more"


# ---- Stops never wait


def test_the_newest_of_each_servo_is_sent_in_one_frame() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(101, leg_to(1, "set 10", "set 20", "set 30")) == []
    assert robot.command(102, servo_to(12, "set 25")) == []
    assert robot.time(120) == ["command 1 set 10 | set 25 | set 30", "completed 3", "completed 2 coalesced"]


def test_what_nothing_waits_for_is_told_what_it_does_already() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90", "stop", "stop"))
    robot.command(101, servo_to(12, "start 20"), "servo/12")
    robot.command(102, servo_to(13, "start 30"), "servo/13")
    assert robot.time(120) == ["command 1 set 90 | start 20 | start 30", "completed 2", "completed 3"]


def test_each_leg_has_rate_slots_of_its_own() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(101, leg_to(2, "start 90")) == ["command 2 start 90", "completed 2"]
    assert robot.command(102, legs_to("123", "start 80")) == ["command 3 start 80"]
    assert robot.time(105) == ["command 1 start 80"]
    assert robot.time(106) == ["command 2 start 80", "completed 3"]


def test_a_command_that_finds_a_rate_slot_is_sent_with_what_waited() -> None:
    """Nobody woke the supervisor in time: the newer target goes out, not first the older one."""
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 10"))
    assert robot.command(125, leg_to(1, "set 20")) == ["completed 2 coalesced", "command 1 set 20", "completed 3"]


def test_a_stop_goes_out_at_once_and_ends_what_waits() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "set 80"))
    assert robot.command(102, leg_to(1, "stop")) == ["command 1 stop", "completed 2 coalesced", "completed 3"]
    assert robot.time(120) == []
    assert robot.supervisor.mode is Mode.IDLE


def test_a_stop_among_moves_does_not_wait_for_them() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(101, leg_to(1, "set 80", "stop", "set 70")) == ["command 12 stop"]
    assert robot.running == [11, 13]
    assert robot.time(120) == ["command 1 set 80 | stop | set 70", "completed 2"]


def test_a_stop_among_moves_reaches_a_servo_that_seems_to_be_stopped() -> None:
    """Its Stop may have been lost on the wire, which acknowledges nothing."""
    robot = Steps()
    robot.command(100, leg_to(1, "start 90", "stop", "start 90"))
    assert robot.command(101, leg_to(1, "set 80", "stop", "set 80")) == ["command 12 stop"]


def test_stops_come_first_in_a_command_for_several_legs() -> None:
    robot = Steps()
    robot.command(100, leg_to(2, "start 90"))
    mixed = leg_to(1, "start 90") + leg_to(2, "stop")
    assert robot.command(130, mixed, "legs") == ["command 2 stop", "command 1 start 90", "completed 2"]


def test_stops_for_two_servos_of_a_leg_are_two_frames() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    assert robot.command(101, servo_to(11, "stop") + servo_to(13, "stop")) == [
        "command 11 stop",
        "command 13 stop",
        "completed 2",
    ]
    assert robot.running == [12]


def test_a_stop_to_a_leg_that_does_not_run_is_sent() -> None:
    robot = Steps()
    assert robot.command(1, leg_to(4, "stop")) == ["command 4 stop", "completed 1"]
    assert robot.command(2, servo_to(42, "stop")) == ["command 42 stop", "completed 2"]


# ---- within one instant


@pytest.mark.parametrize("move", ["start 90", "set 90"])
def test_a_stop_wins_over_another_channels_move_in_the_same_instant(move: str) -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(130, leg_to(1, "stop"), "legs")
    assert robot.command(130, servo_to(11, move), "servo/11") == ["rejected 3 servo_stopped"]
    assert robot.command(130, leg_to(2, move.replace("set", "start")), "leg/2")[0].startswith("command 2")


def test_the_other_way_round_it_wins_as_well() -> None:
    robot = Steps()
    assert robot.command(130, servo_to(11, "start 90"), "servo/11") == ["command 11 start 90", "completed 1"]
    assert robot.command(130, leg_to(1, "stop"), "legs") == ["command 1 stop", "completed 2"]
    assert robot.running == []


def test_one_channels_own_order_is_known_and_no_others_however_long_an_instant_takes() -> None:
    robot = Steps()
    robot.instant_ms = 130
    robot.command(130.5, leg_to(1, "stop"), "put leg/1")
    assert robot.command(131, leg_to(1, "start 90"), "get leg/1") == ["rejected 2 servo_stopped"]
    assert robot.command(131.5, leg_to(1, "start 90"), "put leg/1") == ["command 1 start 90", "completed 3"]


def test_all_who_stop_in_an_instant_count() -> None:
    robot = Steps()
    robot.command(130, servo_to(11, "stop"), "servo/11")
    robot.command(130, leg_to(1, "stop"), "leg/1")
    assert robot.command(130, leg_to(1, "start 90"), "leg/1") == ["rejected 3 servo_stopped"]
    assert robot.command(130.001, leg_to(1, "start 90"), "leg/1") == ["command 1 start 90", "completed 4"]


def test_a_stop_among_moves_wins_too() -> None:
    robot = Steps()
    robot.command(130, leg_to(1, "start 90", "stop", "start 90"), "leg/1")
    assert robot.command(130, servo_to(12, "start 90"), "servo/12") == ["rejected 2 servo_stopped"]
    assert robot.running == [11, 13]


# ---- the queue of starts


JOINTS = pytest.mark.parametrize("joint", [1, 2, 3])


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


# ---- Stops that come with moves


def test_a_leg_whose_rate_slot_has_not_come_keeps_its_place() -> None:
    robot = staggered(1)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, leg_to(1, "stop"))
    assert robot.command(103, leg_to(1, "start 80")) == []
    assert robot.command(104, leg_to(2, "start 90")) == []
    assert robot.time(105) == ["command 1 start 80", "completed 3"]
    assert robot.time(106) == ["command 2 start 90", "completed 4"]


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
