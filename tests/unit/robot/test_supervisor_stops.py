"""The gateway's own Stops: the watchdog, the repeats, legs at rest, the emergency stop, and beside `stop-servos`."""

from typing import Final

import pytest

from gateway.model.frames import STARTS, OneLeg
from gateway.robot.core.events import Announce, Command, EmergencyStop, Reset
from gateway.robot.core.rules import Rules
from schemas.robot import LEGS, SERVO_IDS
from tests.support.scenes import Scenes, play, scene_test

# ---- 4, the watchdog


def test_a_silent_leg_is_stopped() -> None:
    play("""
        100 leg 1 start 90
        due 350
        349.999 time → nothing
        350 time → watchdog 1 stop; announce watchdog_expired
        legs 1
        mode idle
        expirations 1
        due never
        watchdogs expired idle idle idle idle idle""")


def test_an_emergency_stop_and_its_reset_name_the_session_that_asked() -> None:
    robot = Scenes()
    robot.take(10, EmergencyStop("anna", source_id="a1"))
    assert (robot.only(Announce).source, robot.only(Announce).source_id) == ("anna", "a1")
    robot.take(20, Reset(number=1, estop=1, source="ben", source_id="b2"))
    assert (robot.only(Announce).source, robot.only(Announce).source_id) == ("ben", "b2")


def test_a_taken_leg_names_the_session_that_took_it() -> None:
    robot = Scenes()
    for number, (source, source_id) in enumerate([("anna", "a1"), ("ben", "b2")], 1):
        targets = OneLeg(1, [STARTS[90_00]] * 3).servos
        robot.take(10 * number, Command(targets, key="leg", number=number, source=source, source_id=source_id))
    (event,) = robot.announced
    assert (event.kind, event.source, event.source_id) == ("source_changed", "ben", "b2")


def test_other_legs_do_not_feed_it() -> None:
    play("""
        100 leg 1 start 90
        300 leg 2 start 90
        350 time → watchdog 1 stop; announce watchdog_expired
        running 21 22 23""")


def test_rejected_commands_do_not_feed_it() -> None:
    play("""
        rules joint_limits_cdeg={11: (0, 9000)}
        100 servo 11 start 90
        200 servo 12 set 90 → rejected 2 servo_stopped
        300 servo 11 set 91 → rejected 3 joint_limit
        350 time → watchdog 1 stop; announce watchdog_expired""")


# ---- repeats


def test_every_stop_is_repeated() -> None:
    play("""
        rules repeats=2, repeat_interval_ms=20
        due 20
        20 time → repeat 1-6 stop
        39 time → nothing
        40 time → repeat 1-6 stop
        due never
        100 leg 1 start 90
        150 servo 12 stop
        170 time → repeat 12 stop
        190 time → repeat 12 stop
        400 time
        420 time → repeat 1-6 stop  # of all legs, since none runs any more""")


def test_repeats_end_when_the_servo_is_started_again() -> None:
    play("""
        rules repeats=3
        10 servo 11 start 90 → command 11 start 90; completed 1
        20 time → repeat 12 stop; repeat 13 stop; repeat 2 stop; …
        40 leg 1 start 90
        60 time → repeat 2 stop; repeat 3 stop; repeat 4 stop; repeat 5 stop; repeat 6 stop""")


# ---- 5, the emergency stop


def test_a_reset_leaves_the_latch_and_nothing_moves() -> None:
    play("""
        100 leg 1 start 90
        110 estop
        120 reset → announce estop_reset; completed 2
        mode idle
        400 time → nothing
        410 leg 1 set 90 → rejected 3 servo_stopped""")


def test_emergency_stops_are_numbered_and_a_reset_must_name_the_latest() -> None:
    robot = play("101 estop\n102 estop")
    assert robot.supervisor.latch.number == 2
    robot.play("""
        110 reset -1 → rejected 1 estopped
        says a newer emergency stop was requested: estop is 1, and the latest is 2
        111 reset 1 → rejected 2 estopped
        says no such emergency stop was requested: estop is 3, and the latest is 2
        mode estopped
        112 reset → announce estop_reset; completed 3
        113 estop""")
    assert robot.supervisor.latch.number == 3


SCENES: Final = {
    "any accepted command that starts or sets a servo of the leg feeds it": """
        100 leg 1 start 90
        300 leg 1 start 80
        500 servo 12 set 80
        700 legs 12 start 1
        900 leg 1 stop | stop | set 80
        1149 time → watchdog 2 stop; …
        1150 time → watchdog 1 stop; …""",
    "a stop for one servo does not keep the others running": """
        100 leg 1 start 90
        200 servo 12 stop
        300 servo 12 stop + leg 2 start 90
        350 time → watchdog 1 stop; …
        running 21 22 23""",
    "one silent leg stops all six where the scope is the robot": """
        rules whole_robot=True
        100 leg 1 start 90
        200 leg 2 start 90
        204 leg 2 set 80
        350 time → watchdog 1-6 stop; rejected 3 stale; announce watchdog_expired
        legs 123456
        watchdogs expired expired idle idle idle idle
        expirations 1""",
    "it takes the place of a watchdogs stop": """
        1 leg 1 start 90
        251 time
        watchdogs expired idle idle idle idle idle
        252 estop
        watchdogs idle idle idle idle idle idle""",
    "a set of another key in the instant of a Stop is rejected though its servo runs again": """
        1 leg 1 start 90
        instant 100
        100 leg 1 stop → …
        101 leg 1 start 90 → command 1 start 90; …
        130 servo 11 set 80 (key servo) → rejected 4 servo_stopped
        instant ends
        131 servo 11 set 80 (key servo) → command 11 set 80; completed 5""",
    "of one instant an emergency stop is the newer however long it takes to deal with it": """
        instant 100
        100.5 estop
        101 reset → rejected 1 estopped
        says the emergency stop was engaged in the same instant
        instant 101.5
        102 reset → announce estop_reset; completed 2""",
    "without an emergency stop no reset is too old": """
        1 reset 7 → completed 1
        2 unnumbered → completed 2""",
    "a reset without a number is taken 2 s after the latest emergency stop": """
        100 estop
        1000 estop
        2999.999 unnumbered → rejected 1 estopped
        says the emergency stop was requested 2.0 s ago; a reset without its number (estop) is accepted after 2 s
        3000 unnumbered → announce estop_reset; completed 2""",
    "a stop beside moves leaves first in a frame of its own": """
        10 leg 1 start 90
        50 leg 1 stop | set 80 | set 80 → command 11 stop; command 1 stop | set 80 | set 80; completed 2
        51 leg 1 stop | set 70 | stop → command 11 stop; command 13 stop  # the set waits for its rate slot
        due 55
        55 time → command 12 set 70; completed 3""",
    # An earlier run may have left one engaged.
    "until it is known an emergency stop counts as engaged and no reset leaves it": """
        rules estop_kept=True
        mode estopped
        1 leg 1 start 90 → rejected 1 estopped
        3000 reset → rejected 2 estopped
        3001 disk 0 → nothing
        mode idle
        3002 leg 1 start 90 → command 1 start 90; completed 3""",
    "numbers go on so a reset of an earlier run leaves no emergency stop of this one": """
        rules estop_kept=True
        1 disk 7
        2 estop
        3 reset -1 → rejected 1 estopped
        says a newer emergency stop was requested: estop is 7, and the latest is 8""",
    # Stops that `stop-servos` sends, which the supervisor did not.
    "beside stop-servos all count as stopped and get a stop from here too": """
        100 legs 36 start 90
        101 leg 3 set 80
        102 outside begins → repeat 1-6 stop; rejected 2 servo_stopped; announce stopped_outside
        running none
        mode idle
        due never""",
    "starts and sets are rejected until stop-servos has ended and stops are taken": """
        100 outside begins
        105 outside begins → repeat 1-6 stop  # announced once
        110 leg 1 start 90 → rejected 1 servo_stopped
        mentions once it has ended
        111 servo 11 set 90 → rejected 2 servo_stopped
        112 leg 1 stop → command 1 stop; completed 3
        113 calibrate 32 trim 1 → rejected 4 servo_stopped
        120 outside ends → nothing
        130 servo 11 set 90 → rejected 5 servo_stopped  # it does not run
        131 leg 1 start 90 → command 1 start 90; completed 6""",
    # Not those that rest, nor a second time those that another cause has stopped in the same step.
    "an event for each cause names the legs that ran or waited to start": """
        rules start_pause_ms=15
        100 legs 12 start 90 (source anna)
        101 legs 123 stop (source bert)
        halted bert stopped legs 1 and 2
        102 legs 123 stop (source bert)
        halted
        200 leg 1 start 90
        440 leg 2 start 90
        450 leg 1 stop
        halted the watchdog stopped leg 1
        460 estop
        halted the emergency stop stopped leg 2""",
}
test_a_scene = scene_test(SCENES)


# ---- when, and to whom


def test_while_others_run_each_leg_at_rest_gets_a_stop_every_800_ms() -> None:
    play("""
        rules timeout_ms=10000, rest_runs=3
        100 leg 1 start 90
        800 servo 21 start 90
        due 900
        899 time → nothing
        900 time → repeat 3 stop; repeat 4 stop; repeat 5 stop; repeat 6 stop
        due 1700""")


AT_REST: Final = {
    "a stop of all legs ends the rounds": """
        rules rest_runs=1
        100 leg 1 start 90
        200 estop
        due 1300""",
    "the stops that join a silent leg's are repeated": """
        rules repeats=1, rest_runs=0
        20 time
        100 leg 1 start 90
        200 leg 2 start 90
        350 time → watchdog 1 stop; announce watchdog_expired
        joined 3456
        360 leg 2 set 91
        370 time → repeat 1 stop; repeat 3 stop; repeat 4 stop; repeat 5 stop; repeat 6 stop""",
    "a bus that opens again owes each repeat anew": """
        rules repeats=1, rest_runs=0
        20 time
        100 leg 1 stop
        101 fail
        102 open
        due 122""",
    "while nothing runs all pending repeats leave with the first": """
        rules repeats=1, rest_runs=0
        20 time
        100 leg 1 stop
        110 leg 2 stop
        120 time → repeat 1 stop; repeat 2 stop
        130 time → nothing""",
    "a service that ends waits for no further run": """
        rules rest_runs=3
        100 leg 1 start 90
        200 leg 1 stop
        due 1300
        300 end
        due never""",
    "where all legs run there is no round": """
        rules timeout_ms=10000, rest_runs=3
        10 legs 123456 start 90
        due 10010""",
}
test_a_scene_at_rest = scene_test(AT_REST)


# ---- more runs, once nothing runs

RUN_MS = 1100
REPEATED = [f"repeat {number} stop" for number in LEGS]
SINGLY = [f"repeat {servo_id} stop" for servo_id in SERVO_IDS]


def at_rest() -> Scenes:
    """Return scenes opened at 0 ms, in which nothing is owed any more at 5000 ms."""
    robot = Scenes(Rules(repeats=3))
    assert runs_of(robot) == [20, 40, 60, *(60 + RUN_MS * run for run in (1, 2, 3, 4))], "after the Stops at the start"
    return robot


def runs_of(robot: Scenes) -> list[float]:
    """Wake it up when it asks, until it asks no more. Return when all legs got Stops, each servo's own last."""
    found = []
    words: list[str] = []
    while robot.due_ms is not None:
        due_ms = robot.due_ms
        words = robot.time(due_ms)
        if words in (REPEATED, SINGLY):
            found += [due_ms]
        assert words != SINGLY or robot.due_ms is None
    assert words == SINGLY or robot.supervisor.legs.stops.runs == 0
    return found


@pytest.mark.parametrize(
    "stops",
    [
        *("5000 leg 1 start 90\n 5010 leg 1 stop", "4760 leg 1 start 90\n 5010 time", "5010 outside begins"),
        *("5010 estop", "5010 servo 11 stop", "5000 fail\n 5010 open"),
    ],
)
def test_three_more_runs_follow_whatever_brings_the_last_leg_to_rest(stops: str) -> None:
    """Or stops a robot at rest: bytes of that Stop may be lost, too."""
    robot = at_rest().play(stops)
    assert [round(each - 5010) for each in runs_of(robot)][-4:] == [1160, 2260, 3360, 4460]


def test_a_stop_while_they_are_owed_moves_none_and_three_more_are_far_enough_behind_it() -> None:
    robot = at_rest().play("5000 estop\n 6149 pass\n 6150 estop")
    assert runs_of(robot) == [6170, 6190, 6210, 7310, 8410, 9510, 10_610], "6160 is among its repeats"
    runs = runs_of(robot.play("12000 estop\n 12020 time\n 13000 estop"))
    assert 13_160 in runs, "where it was"
    assert [each for each in runs if each >= 13_060 + 1000] == [14_260, 15_360, 16_460, 17_560]
