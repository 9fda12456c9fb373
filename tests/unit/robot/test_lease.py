"""Who drives: each rule of the lease, judged by the oracle as well. In the scenes a token is its holder's name."""

from typing import Final

import pytest

from gateway.robot.core.events import RequestAnswer
from gateway.robot.core.lease import MOST_ASKERS
from tests.support.scenes import Scenes, play, scene_test

BERT: Final = "bert"
HELD: Final = """
    0 lease acquire anna (fresh anna) → announce lease_acquired; granted
    1 leg 1 start 90 (lease anna) → command 1 start 90; completed 1
"""
"""Anna holds the lease since 0 ms, and leg 1 runs."""
SLOW: Final = "rules timeout_ms=10000, rest_ns=10_000_000_000" + HELD
"""With a watchdog that does not stop the leg before."""


@pytest.mark.parametrize("other", ["", " (lease bert)", " (lease annA)"])
def test_only_its_holder_moves_and_resets_and_everybody_stops(other: str) -> None:
    play(f"""{HELD}
        30 leg 1 set 45{other} → rejected 2 not_holder
        30 leg 2 start 90{other} → rejected 3 not_holder
        31 servo 11 stop{other} → command 11 stop; completed 4
        32 leg 1 stop | set 1 | set 1{other} → command 11 stop; rejected 5 not_holder stopped
        33 estop → estop 1-6 stop; announce estop_engaged
        34 reset{other} → rejected 6 not_holder
        35 reset (lease anna) → announce estop_reset; completed 7
        36 calibrate 32 trim 1{other} → rejected 8 not_holder""")


def test_a_takeover_stops_all_six_legs_first() -> None:
    robot = play(f"""{HELD}
        2 leg 1 set 45 (lease anna)
        3 lease take bert (fresh bert)
            → command 1-6 stop; rejected 2 not_holder; announce lease_taken; granted
        announces bert has taken the lease from anna; all six legs are stopped
        source bert""")
    assert robot.only(RequestAnswer).token == BERT
    robot.play("""
        30 leg 1 start 90 (lease anna) → rejected 3 not_holder
        31 leg 1 set 45 (lease bert) → rejected 4 servo_stopped
        32 leg 1 start 90 (lease bert) → command 1 start 90; completed 5
        60 leg 1 stop (lease anna) → command 1 stop; completed 6""")


@pytest.mark.parametrize(
    "kept", ["lease renew (token anna)", "reset (lease anna)", "leg 1 set 45 (lease anna)", "leg 1 stop (lease anna)"]
)
def test_whatever_of_its_holder_is_accepted_keeps_it(kept: str) -> None:
    play(f"""{SLOW}
        900 {kept}
        1001 time → nothing
        due 1900
        1900 time → announce lease_expired""")


def test_few_askers_are_remembered_the_latest() -> None:
    asked = "\n".join(f"2 lease ask person {number}" for number in range(MOST_ASKERS + 1))
    play(f"""{HELD}{asked}
        3 lease release to person 0 (token anna) → lease_denied
        3 lease release to person 1 (token anna) → announce lease_released; granted""")


def test_no_repr_shows_a_token() -> None:
    anna, bert = "a" * 32, "b" * 32
    robot = Scenes()
    seen = [*map(repr, robot.do(0, f"lease acquire anna (fresh {anna})")), repr(robot.effects)]
    for words in (f"renew (token {anna})", f"take bert (fresh {bert})"):
        robot.do(2, f"lease {words}")
        seen += [repr(robot.effects), repr(robot.only(RequestAnswer)), repr(robot.supervisor.lease)]
    assert not [each for each in seen if anna in each or bert in each]


SCENES: Final = {
    # It may be that of somebody whose lease was taken, and has been released since.
    "a token is rejected while it is free and stops are not": """
        1 leg 1 start 90 (lease anna) → rejected 1 not_holder
        2 leg 1 stop (lease anna) → command 1 stop; completed 2
        3 estop
        4 reset (lease anna) → rejected 3 not_holder
        5 lease ask bert → no_lease""",
    "where it is required nothing moves without it": """
        rules lease_required=True
        1 leg 1 start 90 → rejected 1 no_lease
        2 leg 1 stop → command 1 stop; completed 2
        3 estop
        4 reset → announce estop_reset; completed 3  # a reset moves nothing
        5 lease acquire anna (fresh anna)
        6 leg 1 start 90 (lease anna) → command 1 start 90; completed 4
        7 lease release (token anna)
        announces anna has released the lease
        30 leg 1 set 45 → rejected 5 no_lease""",
    "what others had waiting is dropped for a new holder": """
        1 leg 3 start 90
        2 leg 3 set 95 → nothing  # it waits for its rate slot
        3 lease acquire anna (fresh anna) → rejected 2 not_holder; …""",
    "a command that comes after its ttl does not save it": f"""{SLOW}
        1001 leg 1 set 45 (lease anna) → announce lease_expired; rejected 2 not_holder
        1002 lease release (token anna) → not_holder""",
}
test_a_scene = scene_test(SCENES)


ANNA_HOLDS_IT: Final = {
    "a rejection names the holder": """
        30 leg 1 set 45 → rejected 2 not_holder
        says anna holds the lease
        30 leg 1 set 45 (lease bert) → rejected 3 not_holder
        says the command's own lease has ended, and anna holds the lease""",
    "silence loses it in its ttl and the legs are the watchdogs affair": """
        251 time → watchdog 1 stop; announce watchdog_expired
        due 1001
        1000.999 time → nothing
        1001 time → announce lease_expired
        announces anna was silent for 1000 ms and has lost the lease
        source anna
        asked nobody
        1002 leg 1 start 90 (lease anna) → rejected 2 not_holder
        1003 lease renew (token anna) → not_holder
        1004 lease acquire bert (fresh bert) → announce lease_acquired; granted""",
    "a client that asks is announced, and changes nothing": """
        2 lease ask bert → announce lease_asked; granted
        announces bert asks anna for the lease
        source bert
        asked bert
        3 lease ask carl
        asked carl
        4 lease ask bert
        asked bert
        30 leg 1 set 45 (lease anna) → command 1 set 45; completed 2
        251 lease renew (token anna)
        1400 time → …; announce lease_expired; …
        asked nobody""",
    "a handover goes to one who has asked and the legs go on": """
        2 lease release to bert (token anna) → lease_denied  # he has not asked
        3 lease ask bert
        4 lease release to nobody (token anna) → lease_denied
        30 leg 1 set 45 (lease anna) → command 1 set 45; completed 2  # it is still hers
        31 lease release to bert (token anna) → announce lease_released; granted
        holder bert
        60 leg 1 set 45 (lease anna) → rejected 3 not_holder
        60 leg 1 set 45 (lease bert) → rejected 4 not_holder
        60 leg 1 set 45 → rejected 5 not_holder
        61 lease acquire carl (fresh carl) → lease_held
        answers the lease is handed over to bert
        61 lease ask carl → lease_held
        62 lease acquire bert (fresh bert) → announce lease_acquired; granted
        63 leg 1 set 45 (lease bert) → command 1 set 45; completed 6""",
    "the end of the service ends it": """
        2 end
        holder nobody
        due never
        3 lease take bert (fresh bert) → stopping""",
}
test_a_scene_in_which_anna_holds_it = scene_test(ANNA_HOLDS_IT, HELD)
