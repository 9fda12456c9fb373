"""Interlocks by what the robot measures: a low battery, a body that is tilted, a controller that does not answer.

Each step is judged by the oracle.
"""

from typing import Any, Final

import pytest

from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.events import Transmit
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from tests.support.scenes import play

LIMITED: Final = "rules min_battery_mv=7000, max_tilt_cdeg=3000\n 5 body 0\n 10 leg 3 start 90\n"
"""Leg 3 runs since 10 ms, on a robot with a limit for its battery (7 V) and for its tilt (30 degrees)."""


@pytest.mark.parametrize("limit", [{"min_battery_mv": 1}, {"max_tilt_cdeg": 1}])
def test_with_one_limit_measurements_are_wanted(limit: dict[str, Any]) -> None:
    assert Supervisor(Rules(**limit)).body.watches


# ---- the battery


def test_a_low_battery_starts_nothing_and_what_runs_goes_on() -> None:
    play(f"""{LIMITED}
        20 body 0 (battery 6.99) → announce battery_low
        announces the battery is at 6.99 V, below 7 V; nothing starts until it is charged
        30 servo 11 start 90 → rejected 2 battery_low
        says the battery is below 7 V; nothing starts until it is charged
        40 leg 3 set 80 → command 3 set 80; completed 3
        70 leg 3 start 70 → command 3 start 70; completed 4  # it runs already
        80 leg 3 stop → command 3 stop; completed 5
        90 leg 3 start 90 → rejected 6 battery_low""")


def test_a_voltage_that_jitters_is_announced_once() -> None:
    play(f"""{LIMITED}
        20 body 0 (battery 6.9) → announce battery_low
        40 body 0 (battery 7.0) → nothing
        60 body 0 (battery 6.9) → nothing
        80 body 0 (battery 7.139) → nothing
        100 body 0 (battery 6.99) → nothing
        110 leg 4 start 90 → rejected 2 battery_low
        120 body 0 (battery 7.14)
        130 leg 4 start 90 → command 4 start 90; completed 3
        140 body 0 (battery 7.0) → nothing
        160 body 0 (battery 6.999) → announce battery_low""")


def test_a_battery_that_was_not_measured_yet_starts_nothing() -> None:
    play("""rules min_battery_mv=7000
        10 leg 3 start 90 → rejected 1 battery_low
        says the battery has not been measured yet; nothing starts until it is
        20 leg 3 stop → command 3 stop; …
        30 body unknown
        40 leg 3 start 90 → command 3 start 90; …""")


# ---- the body


def test_a_body_that_is_tilted_for_200_ms_is_stopped() -> None:
    steps = play(f"""{LIMITED}
        20 body 30.01 → nothing
        219.9 body 180 → nothing
        220 body 30.01 → watchdog 1-6 stop; announce fallen
        running none
        legs 123456
        announces the body has been tilted beyond 30 degrees for 200 ms; all six legs are stopped""")
    deadlines_ns = {transmit.deadline_ns for transmit in steps.effects if isinstance(transmit, Transmit)}
    assert deadlines_ns == {(60_000 + 220) * NS_PER_MS}


def test_until_it_stands_again_nothing_moves_and_a_stop_is_taken() -> None:
    play(f"""{LIMITED}
        20 body 31
        230 body 31
        240 leg 3 start 90 → rejected 2 fallen
        says the body is tilted beyond 30 degrees; put it upright, and start it again
        250 leg 3 stop → command 3 stop; …
        260 body unknown → nothing
        270 leg 3 start 90 → rejected 4 fallen  # unknown is not upright
        280 body 30 → nothing
        running none  # it stands, and nothing starts by itself
        290 leg 3 start 90 → command 3 start 90; completed 5""")


def test_an_unknown_tilt_neither_begins_nor_ends_the_time() -> None:
    play(f"""{LIMITED}
        20 body unknown → nothing
        230 body unknown → nothing
        240 leg 3 set 90
        250 body 31
        260 body unknown → nothing
        450 body unknown → watchdog 1-6 stop; announce fallen""")


def test_where_a_landing_is_configured_it_lands() -> None:
    steps = play(f"""{LIMITED.replace("rules", "rules landing_ms=1000,")}
        20 body 31
        225 body 31 → announce landing; announce fallen""")
    assert steps.announced[0].detail == "the body is tilted; the robot lands, and is stopped 1000 ms later"
    assert steps.announced[1].detail.endswith("200 ms; the robot lands")
    steps.play("""
        300 body 0 → nothing  # what lands is not turned round
        1220 time → watchdog 1-6 stop; announce watchdog_expired""")


def test_measurements_of_a_bus_at_fault_are_kept() -> None:
    play(f"""{LIMITED}
        20 fail
        30 body 170 (battery 6)
        240 body 170 (battery 6) → announce fallen
        250 open
        260 leg 3 start 90 → rejected 2 fallen""")


def test_the_settings_are_the_rules() -> None:
    settings = {"wire": {"name": "elkapod-2025"}, "safety": {"min_battery_v": 6.6, "max_tilt_deg": 45}}
    made = rules(Settings.of(settings))
    assert (made.min_battery_mv, made.max_tilt_cdeg, made.tilt_ns) == (6600, 45_00, 200 * NS_PER_MS)
    assert made.starts_whole
    assert made.stops_whole
    default = rules(Settings())
    assert (default.min_battery_mv, default.max_tilt_cdeg, default.starts_whole, default.stops_whole) == (0,) * 4


# ---- a controller that does not answer


def test_a_silent_controller_is_a_fault_and_its_return_is_announced_as_that() -> None:
    play(f"""{LIMITED}
        20 fail controller_silent → announce controller_silent
        mode bus_fault
        30 leg 3 set 90 → rejected 2 bus_fault
        40 open → startup 1-6 stop; announce controller_returned
        announces the controller answers again; all servos are stopped
        50 fail → announce bus_fault
        60 fail controller_silent → nothing  # a fault is announced once
        70 open → startup 1-6 stop; announce bus_recovered""")
