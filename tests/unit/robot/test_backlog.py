"""Starts without `sent_ms` that a link has held back: of a burst, a leg that does not run takes none."""

from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.robot.core.backlog import START_WAIT_NS
from tests.support.scenes import play, scene_test

RULES: Final = f"rules start_wait_ms={START_WAIT_NS / NS_PER_MS}\n"
STAGGERED: Final = RULES.replace("rules", "rules start_pause_ms=50,")


def test_the_fourth_message_in_one_slot_is_a_burst_and_no_start_of_it_is_ever_sent() -> None:
    play(f"""{RULES}
        100 leg 1 start 90
        101 leg 1 start 90
        102 leg 1 start 90
        103 leg 1 start 90 → rejected 3 stale; rejected 4 stale
        due never
        200 leg 1 start 90 → rejected 5 stale
        353 leg 1 start 90 → nothing  # the watchdog's time has passed without a burst
        368 time → command 1 start 90; completed 6""")


SCENES: Final = {
    "a lone start leaves within one slot with the newest angle": f"""{RULES}
        100 leg 1 start 90 → nothing
        110 leg 1 set 80 → completed 1 coalesced
        due 115
        115 time → command 1 start 80; completed 2""",
    "a message behind the window is of no burst": f"""{RULES}
        100 leg 1 start 90 → nothing
        105 leg 1 start 90 → completed 1 coalesced
        110 leg 1 start 90 → completed 2 coalesced
        120 leg 1 start 90 → completed 3 coalesced; command 1 start 90; completed 4""",
    "sets are of the burst too and a start before them is dropped": f"""{RULES}
        100 leg 6 start 90
        101 leg 6 set 90
        102 leg 6 set 90
        103 leg 6 set 90 → rejected 3 stale; rejected 4 servo_stopped""",
    "at 200 Hz the seventh message in 20 ms is one too many": f"""{RULES.replace("rules", "rules period_ms=5,")}
        100 leg 6 start 90
        101 leg 6 set 90
        102 leg 6 set 90
        103 leg 6 set 90
        104 leg 6 set 90
        105 leg 6 set 90 → completed 5 coalesced
        106 leg 6 set 90 → rejected 6 stale; rejected 7 servo_stopped""",
    "a start that waits for later messages keeps no other leg waiting": f"""{STAGGERED}
        50 leg 2 start 90
        65 time
        120 leg 1 start 90
        121 timed leg 3 start 90 → command 3 start 90; completed 99""",
    "a stop of a burst is a stop": f"""{RULES}
        100 leg 1 start 90
        101 leg 1 start 90
        102 leg 1 start 90
        103 leg 1 start 90
        104 leg 1 start 90 + leg 2 stop → command 2 stop; rejected 5 stale stopped
        105 leg 1 stop → command 1 stop; completed 6""",
}
test_a_scene = scene_test(SCENES)
