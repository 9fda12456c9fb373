"""Landing: when a leg falls silent, the whole robot goes to its pose, and then gets its Stops. Each step is judged."""

from typing import Final

import pytest

from tests.support.scenes import play, scene_test

LANDS: Final = "rules landing_ms=1000, landing_cdeg={31: 3000, 42: 10000}\n 10 legs 34 start 90\n"
"""Legs 3 and 4 run since 10 ms, and are silent from then on: they land from 260 to 1260 ms, to a pose of two servos."""


def test_silence_lands_the_whole_robot_and_then_stops_it() -> None:
    steps = play(f"{LANDS} 260 time → announce landing\n legs 123456")
    lines = steps.do(1259, "pass")
    for begin, last_deg in ("watchdog 31 set ", 30), ("watchdog 42 set ", 100):
        angles_deg = [float(line.removeprefix(begin)) for line in lines if line.startswith(begin)]
        assert angles_deg == sorted(angles_deg, reverse=last_deg < 90)
        assert angles_deg[-1] == last_deg
        assert 45 <= len(angles_deg) <= 50, "one frame in a period"
    moved = {line.split()[1] for line in lines if "set" in line}
    assert moved == {"31", "42"}, "a servo that the pose does not name holds its angle"
    steps.play("""
        running 31 32 33 41 42 43
        due 1260
        1260 time → watchdog 1-6 stop; announce watchdog_expired
        legs 123456
        mode idle
        watchdogs idle idle expired expired idle idle""")


@pytest.mark.parametrize("late_ms", [0, 5, 15, 16, 20, 40])
def test_a_late_timer_does_not_make_the_landing_slower(late_ms: float) -> None:
    """The steps that follow make up for it, each by one rate slot at most."""
    steps = play(f"{LANDS} 260 time\n due 280")
    assert steps.time(280 + late_ms)[0].startswith("watchdog 31 set")
    lines = steps.do(1259, "pass")
    assert [line for line in lines if line.startswith("watchdog 31 set")][-1] == "watchdog 31 set 30"


@pytest.mark.parametrize("at_ms", [260, 500, 1259, 1260])
def test_the_emergency_stop_ends_it_at_any_instant(at_ms: float) -> None:
    play(f"""{LANDS}
        {at_ms - 0.5} pass
        {at_ms} estop → estop 1-6 stop; announce estop_engaged
        due never
        {at_ms + 1} reset
        {at_ms + 2} leg 3 start 90 → command 3 start 90; …""")


def test_a_late_look_makes_the_landing_no_longer() -> None:
    play(f"{LANDS} 1160 time\n 1260 pass → …; watchdog 1-6 stop; announce watchdog_expired")


SCENES: Final = {
    "a stop stops its leg at once and the others go on": f"""{LANDS}
        260 time
        300 leg 3 stop → command 3 stop; …
        1259 pass → …; watchdog 42 set 100
        running 41 42 43""",
    "a limited speed holds": f"""{LANDS.replace("rules", "rules max_speed_cdeg_s={31: 1000},")}
        1259 pass → …; watchdog 31 set 80.2; …""",
    "a leg whose slot comes later keeps no other from going on": f"""{LANDS.replace("10000", "9024")}
        260 time
        296 time → watchdog 31 set 88.75; watchdog 42 set 90
        300 time → nothing
        301 time → watchdog 31 set 87.5; watchdog 42 set 90.01""",
    "a leg that is still commanded lands too and its commands are rejected": f"""{LANDS}
        200 leg 4 set 91
        260 time
        300 leg 4 set 92 → …; rejected 3 landing; …
        301 leg 5 start 90 → …; rejected 4 landing; …
        302 calibrate 11 trim 1 → …; rejected 5 landing; …
        1259 pass
        1260 leg 4 set 92 → …; rejected 6 servo_stopped  # the landing has ended
        running none
        1262 leg 4 start 92 → command 4 start 92; completed 7""",
    "what waits for its slot is rejected when the landing begins": f"""{LANDS.replace("rules", "rules period_ms=100,")}
        250 leg 4 set 91
        255 leg 4 set 92 → nothing
        260 time → rejected 3 landing; announce landing""",
    "a bus fault never lands": f"""{LANDS}
        260 time
        300 fail
        400 open → startup 1-6 stop; announce bus_recovered
        due never""",
    "the end never lands": f"""{LANDS}
        260 time
        300 end → shutdown 1-6 stop; announce stopping""",
    "after a pause that took as long as the landing it stops at once": f"""{LANDS}
        1260 time → watchdog 3 stop; watchdog 4 stop; …""",
    "where nothing runs nothing lands": """
        rules landing_ms=1000, period_ms=1000
        10 servo 31 start 90
        11 servo 31 stop
        300 servo 31 start 90
        301 servo 31 stop
        600 servo 31 start 90
        601 servo 31 stop  # three rate slots are kept
        700 servo 31 start 90
        950 time → watchdog 3 stop; rejected 7 stale; announce watchdog_expired""",
    "when all are stopped the landing is over": f"""{LANDS}
        260 time
        300 legs 34 stop
        due never
        301 leg 3 start 90 → command 3 start 90; …""",
}
test_a_scene = scene_test(SCENES)
