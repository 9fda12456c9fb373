"""Stops to legs at rest (*Legs at rest*): a servo that nobody started does not stay on."""

from typing import Final

import pytest

from gateway.robot.core.rules import Rules
from schemas.robot import LEGS, SERVO_IDS
from tests.support.scenes import Scenes, play, scene_test

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


SCENES: Final = {
    "legs at rest are stopped with a silent leg and those that run are not": """
        100 leg 1 start 90
        200 leg 2 start 90
        350 time → watchdog 1 stop; announce watchdog_expired
        joined 3456
        running 21 22 23""",
    "a service that ends waits for no further run": """
        rules rest_runs=3
        100 leg 1 start 90
        200 leg 1 stop
        due 1300
        300 end
        due never""",
    "a stop, a repeat that is due and the last run are each written": """
        rules repeats=2, repeat_interval_ms=1, rest_runs=1, rest_run_ms=5
        1 time
        1.5 servo 11 stop
        8.5 time → repeat 1-6 stop
        13.5 servo 13 stop → command 13 stop; repeat 11 stop; repeat 11 stop; repeat 12 stop; repeat 13 stop; …
        due 14.5""",
    "where all legs run there is no round": """
        rules timeout_ms=10000, rest_runs=3
        10 legs 123456 start 90
        due 10010""",
}
test_a_scene = scene_test(SCENES)


# ---- more runs, once nothing runs

RUN_MS = 1100
REPEATED = [f"repeat {number} stop" for number in LEGS]
SINGLY = [f"repeat {servo_id} stop" for servo_id in SERVO_IDS]


def at_rest() -> Scenes:
    """Opened at 0 ms, and nothing is owed any more at 5000 ms."""
    robot = Scenes(Rules(repeats=3))
    assert runs_of(robot) == [20, 40, 60, *(60 + RUN_MS * run for run in (1, 2, 3, 4))], "after the Stops at the start"
    return robot


def runs_of(robot: Scenes) -> list[float]:
    """Wake it up as it wants, until it wants nothing any more: when all legs got Stops, each servo's own at last."""
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
