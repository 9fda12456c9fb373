"""What a power board allows: nothing starts that it does not feed, and what it feeds no longer is stopped.

Each step is judged by the oracle.
"""

from typing import Final

from schemas.robot import LEGS
from schemas.words import Kind
from tests.support.scenes import play, scene_test

BOARD: Final = "rules power=True\n 5 board\n"
"""The board has answered."""
FED: Final = f"{BOARD} 10 leg 3 start 90\n 10 board\n"
"""Leg 3 runs since 10 ms."""
LANDING: Final = FED.replace("power", "landing_ms=1000, power")


def test_a_leg_with_a_servo_that_is_not_fed_any_more_is_stopped_and_the_others_go_on() -> None:
    play(f"""{FED}
        15 leg 4 start 90
        16 board
        20 board (lost 32) → watchdog 3 stop
        running 41 42 43
        30 board → nothing
        running 41 42 43  # fed again, it starts by a command only
        40 leg 3 set 80 → rejected 3 servo_stopped
        50 leg 3 start 80 → nothing
        60 board → command 3 start 80; completed 4""")


def test_a_start_that_waits_for_a_servo_that_is_now_blocked_is_never_sent() -> None:
    play(f"""{FED.replace("power", "period_ms=1000, power")}
        20 leg 3 stop
        30 leg 3 start 90 → nothing
        40 board (refused 31) → watchdog 3 stop; rejected 3 no_power
        1100 time → nothing
        running none""")


def test_all_is_stopped_when_the_board_does_not_answer() -> None:
    play(f"""{FED}
        20 board silent → watchdog 1-6 stop
        30 board silent → nothing  # once
        40 leg 3 start 90 → rejected 2 no_power""")


def test_where_a_landing_is_configured_a_silent_board_makes_it_land() -> None:
    play(f"""{LANDING}
        20 board silent → announce landing
        announces the power board does not answer; the robot lands, and is stopped 1000 ms later
        30 board → nothing  # what lands is not turned round
        40 leg 3 set 80 → rejected 2 landing
        1020 time → watchdog 1-6 stop; announce watchdog_expired""")


def test_doubt_stops_all_legs_and_ends_a_landing() -> None:
    play(f"""{LANDING}
        20 board silent
        30 board (doubt servo 11 is not off) → watchdog 1-6 stop
        running none
        1020 time → nothing""")


SCENES: Final = {
    "nothing starts before the board has answered": """
        rules power=True
        10 leg 3 start 90 → rejected 1 no_power
        says the power board does not answer
        20 board → nothing
        30 leg 3 start 90 → nothing
        40 board → command 3 start 90; completed 2""",
    "where one silent leg stops all six, so does one servo that is not fed any more": """
        rules power=True, whole_robot=True
        5 board
        10 leg 3 start 90
        10 board
        20 board → nothing
        30 board (lost 32) → watchdog 1-6 stop""",
    # The start that nobody fed ends in the step in which the board falls silent.
    "nothing lands where the last servo was stopped in the same step": """
        rules power=True, landing_ms=500, timeout_ms=5000
        5 board
        10 servo 31 start 90
        20 board (fed 31)
        30 servo 32 start 90
        40 servo 41 start 90
        1830 board silent
            → watchdog 3 stop; watchdog 1-6 stop; rejected 2 no_power; rejected 3 no_power""",
}
test_a_scene = scene_test(SCENES)


WITH_A_BOARD: Final = {
    "a start waits until its servos are fed and its watchdog with it": """
        10 leg 3 start 90 → nothing
        running none
        500 board (fed 31 33) → nothing  # all of a command start together
        600 leg 3 set 80 → completed 1 coalesced
        1000 board → command 3 start 80; completed 2  # the newest target
        1249 time → nothing
        1250 time → watchdog 3 stop; announce watchdog_expired""",
    "a start that nobody feeds ends after 1 8 s whatever else is sent": """
        10 leg 3 start 90
        1700 leg 3 set 80
        1809 time → nothing
        1810 time → watchdog 3 stop; rejected 2 no_power
        says the power board has not confirmed that it is fed
        1900 board → nothing""",
    "a stop of the servos that a start waited for lets the others start": """
        10 legs 34 start 90 → nothing
        20 board (fed 31 32 33) → nothing
        30 leg 4 stop → command 4 stop; completed 2; command 3 start 90; completed 1 coalesced""",
}
test_a_scene_with_a_board_that_answers = scene_test(WITH_A_BOARD, BOARD)


WITH_LEG_3_FED: Final = {
    "what the board blocks does not start and all else does": """
        20 board (refused 12 21) → nothing
        30 leg 1 start 90 → rejected 2 no_power
        says servo 12 is not fed: overcurrent; a reset feeds it again
        40 servo 11 start 90 → nothing
        45 board (refused 12 21) → command 11 start 90; completed 3
        50 leg 3 set 80 → command 3 set 80; completed 4
        60 board
        70 servo 12 start 90 → nothing
        80 board → command 12 start 90; completed 5""",
    "a stop and a reset need no board": """
        20 estop
        30 board silent
        35 leg 3 stop → command 3 stop; rejected 2 estopped stopped
        40 reset → announce estop_reset; completed 3
        50 leg 3 stop → command 3 stop; …
        60 leg 3 start 90 → rejected 5 no_power""",
}
test_a_scene_in_which_leg_3_runs = scene_test(WITH_LEG_3_FED, FED)


UNTRUSTED: Final = """rules power=True
 5 board (fed none, rests no)
 10 leg 3 start 90 → nothing
"""
"""The board answers, and no servo was seen at rest yet."""
SUPPLY: Final = {
    "one servo is fed alone until it was seen at rest": """
        supply feed 31
        20 board (fed 31, supplied 31, rests no) → nothing
        30 board (fed 31) → nothing
        supply feed 31 32 33
        40 board → command 3 start 90; completed 1""",
    "a servo that draws before its start is fed alone means that the controller is deaf": """
        20 board (drew 31, rests no) → watchdog 1-6 stop; rejected 1 no_power
        supply cut but none; feed none
        30 leg 4 start 90 → rejected 2 no_power
        mentions servo 31 drew current before it was started: the controller does not obey; a reset lets it try again
        40 reset → completed 3
        supply clear errors
        50 leg 4 start 90 → nothing
        supply feed 41""",
    "an emergency stop cuts all power each time and nothing is fed before a reset": """
        20 estop → estop 1-6 stop; rejected 1 estopped; announce estop_engaged; announce power_cut
        supply cut; feed none
        30 estop → estop 1-6 stop
        supply cut
        40 reset (estop 2) → announce estop_reset; completed 2
        50 leg 3 start 90 → nothing
        supply feed 31
        60 board (rests no) → nothing
        70 board (supplied 31, fed 31) → announce power_restored
        supply feed 31 32 33
        80 board (supplied 31) → command 3 start 90; completed 3""",
    "after an emergency stop one servo is fed alone again": """
        20 board → command 3 start 90; completed 1
        30 estop
        40 reset
        50 leg 3 start 90
        supply feed 31""",
    "after stop-servos one servo is fed alone again": """
        20 board → command 3 start 90; completed 1
        30 outside begins
        40 outside ends
        50 leg 4 start 90
        supply feed 41""",
    "after a board that did not answer one servo is fed alone again": """
        20 board → command 3 start 90; completed 1
        30 board silent
        40 board (rests no)
        50 leg 4 start 90
        supply feed 41""",
    "a servo that draws before its start while others are known to rest is stopped with its leg alone": """
        20 board → command 3 start 90; completed 1
        30 leg 4 start 90 → nothing
        supply feed 31 32 33 41 42 43
        40 board (fed 31 32 33, drew 41, rests no) → watchdog 4 stop; rejected 2 no_power
        running 31 32 33
        supply cut but 31 32 33; feed 31 32 33""",
    "a servo that rests shows that the controller obeys though the same report has one that draws": """
        20 board (drew 31, fed none) → watchdog 3 stop; rejected 1 no_power
        30 leg 4 start 90 → nothing
        supply feed 41 42 43""",
    "a servo that another program has switched off waits for a reset": """
        20 board → command 3 start 90; completed 1
        30 board (lost 32, taken 32) → watchdog 3 stop
        40 servo 31 start 90 → nothing
        supply feed 31
        50 servo 32 start 90 → rejected 3 no_power
        says servo 32 is not fed: another program has switched it off; a reset feeds it again
        60 servo 33 start 90 → nothing
        supply feed 31 33""",
    "after a silence of the board one servo is fed alone again": """
        20 board → command 3 start 90; completed 1
        30 board (lost 32, rests no) → watchdog 3 stop
        40 leg 4 start 90 → nothing
        supply feed 41""",
    "a stopped servo that draws though nobody feeds it stops all and waits for a reset": """
        20 board → command 3 start 90; completed 1
        30 board (drew 12) → watchdog 1-6 stop
        supply cut but none; feed none
        40 leg 1 start 90 → rejected 2 no_power
        says servo 12 is not fed: it drew current after its Stop; a reset feeds it again""",
    "stop-servos leaves what was fed to a reset": """
        20 outside begins → repeat 1-6 stop; rejected 1 servo_stopped; announce stopped_outside
        supply cut but none; feed none
        30 outside ends
        40 servo 31 start 90 → rejected 2 no_power
        50 servo 32 start 90 → nothing
        supply feed 32""",
}
test_a_scene_of_the_supply = scene_test(SUPPLY, UNTRUSTED)


def test_a_fed_robot_goes_the_usual_way_until_a_servo_is_refused() -> None:
    steps = play(FED)
    assert steps.supervisor.usual_ns > 0
    steps.play("20 board (refused 12)")
    assert steps.supervisor.usual_ns == 0


def test_a_cut_concerns_all_legs() -> None:
    steps = play(f"{FED} 20 estop")
    (cut,) = [each for each in steps.announced if each.kind is Kind.POWER_CUT]
    assert cut.legs == tuple(LEGS)
