"""A servo whose speed is limited goes to its target in steps, one in each rate slot. Each step is judged."""

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


@pytest.mark.parametrize("stop", ["60 servo 31 stop", "60 estop", "400 pass"])
def test_a_stop_ends_it(stop: str) -> None:
    steps = play(f"""{RUNS.replace("10000", "1000")}
        51 servo 31 set 180
        {stop} → …; …""")
    assert not angles(steps, 1000)
    assert 31 not in steps.running


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
