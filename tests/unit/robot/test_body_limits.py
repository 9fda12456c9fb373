"""A low battery, and a body that has fallen. Each step is judged by the oracle."""

from typing import Any

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.core.events import Announce, Transmit
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from schemas.telemetry import Kind, Mode
from tests.support.steps import Steps, all_stopped, leg_to, servo_to


def body(**changes: Any) -> Steps:
    """Leg 3 runs since 10 ms, on a robot with a limit for its battery (7 V) and for its tilt (30 degrees)."""
    limits = {"repeats": 0, "min_battery_mv": 7000, "max_tilt_cdeg": 30_00}
    steps = Steps(Rules(**{**limits, **changes}))
    steps.command(10, leg_to(3, "start 90"))
    return steps


def test_without_a_limit_no_measurement_is_wanted_and_none_decides_anything() -> None:
    steps = body(min_battery_mv=0, max_tilt_cdeg=0)
    assert not steps.supervisor.body.watches
    assert steps.measure(20, 180, 0) == []
    assert steps.measure(240, 180, 0) == []
    assert steps.command(250, leg_to(4, "start 90")) == ["command 4 start 90", "completed 2"]


@pytest.mark.parametrize("limit", [{"min_battery_mv": 1}, {"max_tilt_cdeg": 1}])
def test_with_one_limit_measurements_are_wanted(limit: dict[str, Any]) -> None:
    assert Supervisor(Rules(**limit)).body.watches


# ---- the battery


def test_a_low_battery_starts_nothing_and_what_runs_goes_on() -> None:
    steps = body()
    assert steps.measure(20, battery_v=6.99) == ["announce battery_low"]
    assert steps.only(Announce).detail == "the battery is at 6.99 V, below 7 V; nothing starts until it is charged"
    assert steps.command(30, servo_to(11, "start 90")) == ["rejected 2 battery_low"]
    assert steps.detail == "the battery is below 7 V; nothing starts until it is charged"
    assert steps.command(40, leg_to(3, "set 80")) == ["command 3 set 80", "completed 3"]
    assert steps.command(70, leg_to(3, "start 70")) == ["command 3 start 70", "completed 4"], "it runs already"
    assert steps.command(80, leg_to(3, "stop")) == ["command 3 stop", "completed 5"]
    assert steps.command(90, leg_to(3, "start 90")) == ["rejected 6 battery_low"]


def test_a_voltage_that_jitters_is_announced_once() -> None:
    steps = body()
    steps.measure(20, battery_v=6.9)
    for at_ms, battery_v in ((40, 7.0), (60, 6.9), (80, 7.139), (100, 6.99)):
        assert steps.measure(at_ms, battery_v=battery_v) == []
    assert steps.command(110, leg_to(4, "start 90")) == ["rejected 2 battery_low"]
    steps.measure(120, battery_v=7.14)
    assert steps.command(130, leg_to(4, "start 90")) == ["command 4 start 90", "completed 3"]
    assert steps.measure(140, battery_v=7.0) == []
    assert steps.measure(160, battery_v=6.999) == ["announce battery_low"]


# ---- the body


def test_a_body_that_is_tilted_for_200_ms_is_stopped() -> None:
    steps = body()
    assert steps.measure(20, 30.01) == []
    assert steps.measure(219.9, 180) == []
    assert steps.measure(220, 30.01) == [*all_stopped("watchdog"), "announce fallen"]
    assert steps.running == []
    assert {transmit.deadline_ns for transmit in steps.effects if isinstance(transmit, Transmit)} == {
        (60_000 + 220) * NS_PER_MS
    }
    announced = steps.only(Announce)
    assert announced.legs == (1, 2, 3, 4, 5, 6)
    assert announced.detail == "the body has been tilted beyond 30 degrees for 200 ms; all six legs are stopped"


def test_until_it_stands_again_nothing_moves_and_a_stop_is_taken() -> None:
    steps = body()
    steps.measure(20, 31)
    steps.measure(230, 31)
    assert steps.command(240, leg_to(3, "start 90")) == ["rejected 2 fallen"]
    assert steps.detail == "the body is tilted beyond 30 degrees; put it upright, and start it again"
    assert steps.command(250, leg_to(3, "stop"))[0] == "command 3 stop"
    assert steps.measure(260, None) == []
    assert steps.command(270, leg_to(3, "start 90")) == ["rejected 4 fallen"], "unknown is not upright"
    assert steps.measure(280, 30) == []
    assert steps.running == [], "it stands, and nothing starts by itself"
    assert steps.command(290, leg_to(3, "start 90")) == ["command 3 start 90", "completed 5"]


def test_an_unknown_tilt_neither_begins_nor_ends_the_time() -> None:
    steps = body()
    assert steps.measure(20, None) == []
    assert steps.measure(230, None) == []
    steps.command(240, leg_to(3, "set 90"))
    steps.measure(250, 31)
    assert steps.measure(260, None) == []
    assert steps.measure(450, None) == [*all_stopped("watchdog"), "announce fallen"]


def test_where_a_landing_is_configured_it_lands() -> None:
    steps = body(landing_ns=1000 * NS_PER_MS)
    steps.measure(20, 31)
    assert steps.measure(225, 31) == ["announce landing", "announce fallen"]
    assert steps.announced[0].detail == "the body is tilted; the robot lands, and is stopped 1000 ms later"
    assert steps.announced[1].detail.endswith("200 ms; the robot lands")
    assert steps.measure(300, 0) == [], "what lands is not turned round"
    assert steps.time(1220) == [*all_stopped("watchdog"), "announce watchdog_expired"]


def test_measurements_of_a_bus_at_fault_are_kept() -> None:
    steps = body()
    steps.fail(20)
    steps.measure(30, 170, 6)
    assert steps.measure(240, 170, 6) == ["announce fallen"]
    steps.open(250)
    assert steps.command(260, leg_to(3, "start 90")) == ["rejected 2 fallen"]


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
    steps = body()
    assert steps.fail(20, Kind.CONTROLLER_SILENT) == ["announce controller_silent"]
    assert steps.supervisor.mode is Mode.BUS_FAULT
    assert steps.command(30, leg_to(3, "set 90")) == ["rejected 2 bus_fault"]
    assert steps.open(40) == [*all_stopped("startup"), "announce controller_returned"]
    assert steps.only(Announce).detail == "the controller answers again; all servos are stopped"
    assert steps.fail(50) == ["announce bus_fault"]
    assert steps.fail(60, Kind.CONTROLLER_SILENT) == [], "a fault is announced once"
    assert steps.open(70) == [*all_stopped("startup"), "announce bus_recovered"]
