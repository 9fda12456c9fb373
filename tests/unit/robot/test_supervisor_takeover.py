"""A servo that another source commands, or that is started soon behind its Stop, has a takeover's speed until it has
arrived. The oracle judges each step."""

from itertools import pairwise
from typing import Final

import pytest

from tests.support.scenes import play, scene_test

RULES: Final = "rules takeover_cdeg_s=18000\n"
HELD: Final = """
    1 leg 3 start 20 (source anna)
    100 leg 3 start 20 (source anna)
    200 leg 3 start 20 (source anna)
"""
"""Anna's program has started servo 31 at 20 degrees, and holds it there."""
ANNAS: Final = RULES + HELD
SLOT_DEG = 180 / 50


def test_a_second_program_moves_a_servo_no_faster_than_a_takeover_may() -> None:
    steps = play(ANNAS)
    lines = [line for at_ms in range(220, 1200, 20) for line in steps.do(at_ms, "servo 31 set 160 (source bert)")]
    said = [float(line.split()[3]) for line in lines if line.startswith("command 31 set ")]
    assert all(0 < later - earlier <= SLOT_DEG + 0.001 for earlier, later in pairwise(said) if later < 160)
    assert said[0] == pytest.approx(20 + SLOT_DEG)
    assert said[-1] == 160
    assert 140 / 180 * 1000 - 40 < 20 * said.index(160) < 140 / 180 * 1000 + 60


SCENES: Final = {
    "also at the lowest speed": f"""{ANNAS.replace("18000", "1")}
        205 servo 31 set 160 (source bert) → command 31 set 20; …""",
    "the same source leaps as ever": f"""{ANNAS}
        220 servo 31 set 160 (source anna) → command 31 set 160; …""",
    "a start soon behind a stop begins where the servo stands": f"""{ANNAS}
        220 leg 3 stop (source anna)
        270 leg 3 start 35 (source anna) → command 3 start 20; …
        290 time → command 3 set 23.6; …
        400 pass → …; command 3 set 35""",
    "for two seconds": f"""{ANNAS}
        220 leg 3 stop (source anna)
        1000 time
        2220 leg 3 start 160 (source anna) → command 3 start 20; …""",
    "later nobody knows where it hangs": f"""{ANNAS}
        220 leg 3 stop (source anna)
        1000 time
        2221 leg 3 start 160 (source anna) → command 3 start 160; …""",
    "of a leg only the servo that ran begins where it stands": f"""{RULES}
        1 servo 32 start 20 (source anna)
        40 servo 32 stop (source anna)
        80 leg 3 start 35 (source anna) → command 3 start 35 | start 20 | start 35; …""",
    "behind a fault of the bus nobody knows which frame was the last": f"""{ANNAS}
        220 servo 31 set 25 (source anna)
        220 fail
        240 open
        270 leg 3 start 35 (source anna) → command 3 start 35; …""",
    "switched off nothing of it happens": f"""rules takeover_cdeg_s=0
        {HELD}
        220 servo 31 set 160 (source bert) → command 31 set 160; …
        240 leg 3 stop (source bert)
        280 leg 3 start 35 (source bert) → command 3 start 35; …""",
    "a landing keeps a pace of its own": f"""
        rules takeover_cdeg_s=1000, landing_ms=500, landing_cdeg={{31: 9000}}
        {HELD}
        220 servo 31 set 160 (source bert)
        960 pass → …; watchdog 31 set 90; …""",
}
test_a_scene = scene_test(SCENES)


STOPPED: Final = """rules power=True, angles_first=True, takeover_cdeg_s=18000
    1 board (fed none)
    10 servo 31 start 20 (source anna)
    20 board
    100 servo 31 stop (source anna)
    110 board (fed none)
"""
"""Servo 31 of a robot with a power board, whose supply starts servos, ran until 100 ms."""


def test_a_board_whose_supply_starts_a_servo_feeds_it_at_the_angle_where_it_stands() -> None:
    steps = play(f"{STOPPED} 150 servo 31 start 160 (source anna)")
    assert steps.supervisor.legs.to_feed() == {31: 20_00}
    steps.play(
        "160 servo 31 set 170 (source anna)\n 200 board → command 31 start 20; …\n 220 time → command 31 set 23.6; …"
    )


@pytest.mark.parametrize("supply_starts", [True, False])
def test_the_angle_at_which_a_start_begins_stays_however_long_it_waits_for_power(supply_starts: bool) -> None:
    steps = play(STOPPED.replace("angles_first=True", f"angles_first={supply_starts}"))
    steps.play("1500 servo 31 start 160 (source anna)\n 2150 servo 31 set 170 (source bert)")
    assert steps.supervisor.legs.to_feed() == {31: 20_00}
    steps.play("2200 board → command 31 start 20; …")


STOPPED_BESIDE: Final = """rules power=True, angles_first=True, repeats=3
    1 board
    10 servo 32 start 20
    20 board
    100 servo 31 stop
    105 servo 31 start 160
    109 servo 32 set 21
    110 servo 31 stop + servo 32 set 20  # which waits for its rate slot
"""


def test_no_servo_is_fed_at_the_angle_of_a_start_that_was_stopped() -> None:
    steps = play(f"{STOPPED_BESIDE} 300 servo 31 start 90")
    assert steps.supervisor.legs.to_feed() == {31: 90_00, 32: None}


WAITING: Final = """rules power=True, takeover_cdeg_s=18000
    1 board
    10 leg 3 start 60
    20 board
"""
"""Leg 3 of a robot with a power board stands at 60 degrees."""
WAITING_SCENES: Final = {
    "while a neighbour moves": """
        100 servo 31 stop
        200 leg 3 start 150 → command 3 stop | start 150 | start 150
        220 board → command 31 start 60; …
        240 time → command 31 set 63.6""",
    "while a neighbour is taken over and arrives": """
        100 servo 31 stop
        200 servo 31 start 150
        210 servo 32 set 66 (source bert) → command 32 set 63.6; …
        230 time → command 32 set 66
        300 board → command 31 start 60; …""",
    "while another servo is calibrated": """
        100 leg 3 stop
        200 leg 3 start 150
        210 calibrate 11 trim 5
        220 kept
        300 board → command 3 start 60; …""",
    "beyond the time in which its angle is known": """
        100 leg 3 stop
        1900 leg 3 start 150
        2300 board → command 3 start 60; …""",
}
test_a_start_that_waits_for_power_eases = scene_test(WAITING_SCENES, WAITING)
