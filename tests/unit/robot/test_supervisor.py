"""Commands: which are accepted, as a whole or not at all, and when their frames go out."""

from typing import Final

import pytest

from schemas.robot import SERVO_IDS
from tests.support.scenes import play, scene_test


@pytest.mark.parametrize("servo_id", SERVO_IDS)
def test_a_set_is_rejected_where_nothing_was_started(servo_id: int) -> None:
    play(f"1 servo {servo_id} set 90 → rejected 1 servo_stopped\n running none")


@pytest.mark.parametrize(
    "stop",
    ["30 leg 1 stop", "251 time", "30 estop\n 31 reset", "30 fail\n 50 open"],
    ids=["command", "watchdog", "emergency stop", "fault"],
)
def test_a_set_is_rejected_after_every_kind_of_stop(stop: str) -> None:
    play(f"""
        1 leg 1 start 90
        {stop}
        300 leg 1 set 90 → …; rejected {3 if "leg" in stop or "reset" in stop else 2} servo_stopped
        310 leg 1 start 90 → command 1 start 90; …""")


SCENES: Final = {
    "a pending start of a running servo stays a start": """
        10 leg 1 start 90
        15 leg 1 start 80
        20 leg 1 start 70
        21 leg 1 start 60 → nothing
        22 leg 1 set 50 → completed 4 coalesced
        40 time → command 1 start 50; completed 5""",
    "a leg is shown as expired until it is started or stopped as a whole": """
        1000 leg 1 start 90
        1300 servo 12 stop
        watchdogs expired idle idle idle idle idle  # one servo says nothing of the leg
        1310 leg 1 stop
        watchdogs idle idle idle idle idle idle
        1320 leg 1 start 90
        1600 time
        1610 leg 1 start 90
        watchdogs armed idle idle idle idle idle""",
    "who moves a leg that somebody else has moved is announced and a nameless stop is not": """
        1 leg 1 start 90 (source anna)
        100 leg 1 set 80 (source bert) → …; announce source_changed
        announces leg 1 is commanded by bert, and was by anna
        200 servo 11 stop → command 11 stop; completed 3
        300 leg 1 set 80 → rejected 4 servo_stopped
        310 leg 1 start 80 (source anna) → …; announce source_changed
        400 leg 1 set 80 → …; announce source_changed
        announces leg 1 is commanded by somebody without a name, and was by anna""",
    "an angle outside a joints limits rejects the whole command": """
        rules joint_limits_cdeg={12: (2000, 16000)}
        1 leg 1 start 10 → rejected 1 joint_limit
        says servo 12 may go from 20 to 160 degrees; 10 is outside
        2 legs 21 start 160.01 → rejected 2 joint_limit
        running none
        3 leg 1 start 20 → command 1 start 20; completed 3
        30 servo 12 set 160 → command 12 set 160; completed 4
        60 servo 11 set 180 → command 11 set 180; completed 5
        61 leg 1 stop | set 170 | set 80 → command 11 stop; rejected 6 joint_limit stopped
        62 leg 1 stop → command 1 stop; completed 7  # a stop has no angle""",
    "a stream above the rate that keeps a servo stopped leaves it to the repeats": """
        rules repeats=3
        100 leg 1 start 90
        101 leg 1 stop | set 80 | set 80 → command 11 stop
        102 leg 1 stop | set 70 | set 70 → completed 2 coalesced
        121 time → …; repeat 11 stop; …""",
    "a stop among moves does not wait for the repeats of an earlier one": """
        rules repeats=3
        100 leg 1 start 90
        110 leg 1 stop | set 80 | set 80 → command 11 stop; command 1 stop | set 80 | set 80; completed 2
        118 leg 1 stop | set 70 | set 70 → command 11 stop; command 1 stop | set 70 | set 70; completed 3""",
    "a stop among moves does not wait for the repeats if it ends a waiting start": """
        rules repeats=3
        100 leg 1 start 90
        101 leg 1 stop | set 80 | set 80 → command 11 stop
        102 servo 11 start 70 → nothing
        103 leg 1 stop | set 80 | set 80 → command 11 stop; …""",
    "one set to a stopped servo rejects the whole command": """
        1 servo 11 start 90
        30 leg 1 set 80 | start 80 | set 80 → rejected 2 servo_stopped
        says servo 13 does not run; start it before you set it
        60 legs 23 start 80 + servo 41 set 1 → rejected 3 servo_stopped
        running 11""",
    "a command comes just when another legs slot does": """
        100 leg 1 start 90
        105 leg 1 set 90
        110 leg 1 set 90
        112 leg 1 set 80
        120 leg 2 start 90 → command 2 start 90; completed 5; command 1 set 80; …
        due 362  # nothing waits any more""",
    "the newest of each servo is sent in one frame": """
        100 leg 1 start 90
        101 leg 1 set 10 | set 20 | set 30 → nothing
        102 servo 12 set 25 → nothing
        120 time → command 1 set 10 | set 25 | set 30; completed 3; completed 2 coalesced""",
    "a stop goes out at once and ends what waits": """
        100 leg 1 start 90
        101 leg 1 set 80
        102 leg 1 stop → command 1 stop; completed 2 coalesced; completed 3
        120 time → nothing
        mode idle""",
    # Its Stop may have been lost on the wire, which acknowledges nothing.
    "a stop among moves reaches a servo that seems to be stopped": """
        100 leg 1 start 90 | stop | start 90
        101 leg 1 set 80 | stop | set 80 → command 12 stop""",
    "one channels own order is known and no others however long an instant takes": """
        instant 130
        130.5 leg 1 stop (key put leg/1)
        131 leg 1 start 90 (key get leg/1) → rejected 2 servo_stopped
        131.5 leg 1 start 90 (key put leg/1) → command 1 start 90; completed 3""",
    "a stop among moves wins too": """
        130 leg 1 start 90 | stop | start 90 (key leg/1)
        130 servo 12 start 90 (key servo/12) → rejected 2 servo_stopped
        running 11 13""",
    "a leg that need not be energised any more keeps nobody off": """
        rules start_pause_ms=50
        100 servo 22 start 90
        110 servo 21 start 90 → nothing
        112 leg 3 start 90 → nothing
        115 servo 21 stop + servo 22 set 80
        due 150
        150 time → command 3 start 90; completed 3""",
    "a start does not undo the watchdogs stop of its instant": """
        100 leg 1 start 90
        instant 349
        351 leg 1 start 90 (key put leg/1) → watchdog 1 stop; announce watchdog_expired; rejected 2 servo_stopped
        352 leg 1 start 90 (key put leg/1) → rejected 3 servo_stopped""",
}
test_a_scene = scene_test(SCENES)
