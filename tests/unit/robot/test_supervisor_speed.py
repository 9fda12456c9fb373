"""A servo whose speed is limited goes to its target in steps, one in each rate slot. Each step is judged.

A servo that another source commands, or that starts soon after its Stop, has a takeover speed until it has arrived.
"""

from itertools import pairwise
from typing import Final

import pytest

from gateway.robot.core.events import Rejected
from tests.support.scenes import Scenes, play, scene_test

RUNS: Final = "rules max_speed_cdeg_s={31: 10000}\n 1 leg 3 start 90\n"
"""Servo 31 runs at 90 degrees since 0 ms; leg 3 has a rate slot each 20 ms."""


def angles(steps: Scenes, until_ms: float) -> list[float]:
    frames = [line.split() for line in steps.do(until_ms, "pass") if line.startswith("command")]
    assert all(words[1:3] == ["31", "set"] for words in frames), frames
    return [float(words[3]) for words in frames]


def test_a_far_target_is_approached_and_reached() -> None:
    steps = play(f"{RUNS} 51 servo 31 set 110 → command 31 set 92; completed 2")
    said = angles(steps, 300)
    assert said == sorted(said)
    assert said[-1] == 110
    assert len(said) >= (110 - 92) / (100 / 50)


SCENES: Final = {
    "a start of a servo that runs is no way round it": f"""{RUNS}
        51 servo 31 start 180 → command 31 start 92; …""",
    "a legs frame that tells it its angle again counts as its last": f"""{RUNS}
        41 servo 32 set 80 + servo 33 set 80
        51 servo 31 set 180 → command 31 set 91; …""",
    "another servos frame does not": f"""{RUNS}
        41 servo 32 set 80
        51 servo 31 set 180 → command 31 set 92; …""",
    "a stop of another leg ends a start that waits and no motion beside it": """
        rules max_speed_cdeg_s={31: 10000}, start_pause_ms=200
        1 leg 3 start 90
        51 servo 31 set 110 → command 31 set 92; …
        60 servo 32 stop
        61 servo 32 start 90 → nothing
        62 leg 5 stop → …; rejected 4 servo_stopped; …
        71 time → command 31 set 94""",
}
test_a_scene = scene_test(SCENES)


# ---- across angles that are never sent

AVOIDING: Final = "rules timeout_ms=10000, max_speed_cdeg_s={31: 5000}, avoid_cdeg=(100, 400)\n 1 servo 31 start 6\n"
"""Servo 31 may go 50 degrees a second; 1 to 4 degrees are never sent."""


@pytest.mark.parametrize(
    "ended", ["100 servo 31 stop\n 120 servo 31 start 4", "120 lease acquire anna (fresh anna)"], ids=["stop", "holder"]
)
def test_a_way_across_that_has_ended_is_no_part_of_the_next(ended: str) -> None:
    steps = play(f"{AVOIDING} 21 servo 31 set 0")
    assert angles(steps, 90)[-1] == 4, "its way would be at about 2.5 now"
    steps.play(f"{ended}\n 200 servo 31 set 0 {'(lease anna)' if 'anna' in ended else ''}")
    assert set(angles(steps, 240)) == {4}, "the whole way takes 60 ms, and it began at 200"


def test_a_way_across_angles_that_are_never_sent_waits_before_them_until_it_would_be_beyond() -> None:
    steps = play(f"{AVOIDING} 21 servo 31 set 0 → command 31 set 5; …")
    said = angles(steps, 1000)
    assert said[0] in (4.3, 4.75)
    assert {angle for angle in said if 0.99 < angle <= 4} == {4}, "the last angle before them"
    assert said[-1] == 0
    assert 4 <= len([angle for angle in said if angle == 4]) <= 4 * 4, "for as long as the way takes, in each rate slot"


# ---- a command that is rejected once it has begun

BEGUN: Final = """
    rules timeout_ms=1000, power=True, start_pause_ms=2000, max_speed_cdeg_s={31: 1000}
    5 board
    10 leg 5 start 90
    10 board
    500 leg 5 set 90
    1000 leg 5 set 90
    1500 leg 5 set 90
    2000 leg 5 set 90
    2005 servo 31 start 0
    2010 board → …; command 31 start 0; …
    2100 servo 31 set 180 + servo 11 start 90 → command 31 set 0.2
"""
"""Command 7 sends servo 31 on its way, and its start of servo 11 waits, until 4010 ms. Leg 5 is silent from 3000 ms."""


@pytest.mark.parametrize("newer", [False, True])
@pytest.mark.parametrize("rejects", ["2999 leg 2 stop", "2999 board (lost 11)", "2999 lost servo 11 stop", "3000 time"])
def test_a_servo_does_not_go_on_to_where_a_rejected_command_has_sent_it_but_to_where_a_newer_one_has(
    rejects: str, newer: bool
) -> None:
    steps = play(BEGUN)
    assert angles(steps, 2999)[-1] == 9
    if newer:
        steps.play("2998 servo 31 set 100")
    steps.play(rejects)
    assert [effect.request.number for effect in steps.effects if isinstance(effect, Rejected)] == [7]
    assert 31 in steps.running
    later = angles(steps, 3090)
    assert later[-1] > 9.2 if newer else later == [], "it holds where it is"


# ---- a takeover

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


TAKEOVERS: Final = {
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
    "after that its angle is unknown": f"""{ANNAS}
        220 leg 3 stop (source anna)
        1000 time
        2221 leg 3 start 160 (source anna) → command 3 start 160; …""",
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
    "after a bus fault its last frame is unknown": f"""{ANNAS}
        220 servo 31 set 25 (source anna)
        220 fail
        240 open
        270 leg 3 start 35 (source anna) → command 3 start 35; …""",
}
test_a_scene_of_a_takeover = scene_test(TAKEOVERS)


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
