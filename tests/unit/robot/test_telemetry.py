"""What the robot measures: its report, the state, the metrics page and the black box."""

import asyncio
import json
from collections import Counter
from collections.abc import Iterator
from math import cos, radians, sin
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from gateway.model.elkapod import Measured
from gateway.robot.runtime.prometheus import LOOPBACK, Numbers, may_ask, powered
from gateway.robot.spi.bus import Bus
from schemas import keys
from schemas.config import ConfigReport
from schemas.gateway_state import PowerReport
from schemas.robot import LEGS
from schemas.telemetry import ServoTelemetry, Supply, Telemetry
from schemas.words import Kind
from tests.support.pages import described, documented
from tests.support.published import AT_REST, WALL
from tests.support.robot import LEG_3, START, Robot, leg, started
from tests.unit.people.test_recorder import contents, recorded

pytestmark = pytest.mark.virtual_time

ELKAPOD = {"name": "elkapod-2025"}


def published(robot: Robot) -> list[Telemetry]:
    robot.conductor.reports.publish_telemetry()
    return [report for key, report in robot.reports if key == keys.TELEMETRY and isinstance(report, Telemetry)]


def asked(robot: Robot) -> list[bytes]:
    answers: list[bytes] = []
    robot.conductor.reports.answer(keys.TELEMETRY, answers.append)
    return answers


@pytest.mark.parametrize(
    ("orientation_wxyz", "tilt_deg"),
    [((0.0, 0.0, 0.0, 0.0), None), ((0.0, 1.0, 0.0, 0.0), 180), ((3e38, 3e38, 3e38, 3e38), None)],
)
async def test_a_body_without_an_orientation_has_no_tilt(
    orientation_wxyz: tuple[float, float, float, float], tilt_deg: float | None
) -> None:
    robot = started(wire=ELKAPOD)
    robot.conductor.measured(AT_REST._replace(orientation_wxyz=orientation_wxyz), robot.now_ns())
    (answer,) = asked(robot)
    assert json.loads(answer).get("tilt_deg") == tilt_deg
    assert ("tilt_deg" in json.loads(answer)) is (tilt_deg is not None)
    assert ("hexapod_tilt_degrees" in samples(robot)) is (tilt_deg is not None)


async def test_where_nothing_was_measured_nothing_is_published_or_answered() -> None:
    for wire in ({}, ELKAPOD):
        robot = started(wire=wire)
        assert published(robot) == []
        assert asked(robot) == []
        assert robot.state().battery is None
    robot.conductor.close()
    robot.conductor.measured(AT_REST, robot.now_ns())
    assert published(robot) == [], "an answer that comes after the end changes nothing"


@pytest.mark.parametrize(
    ("volts", "tilt_deg", "kinds"),
    [(7.0, 30.0, []), (6.99, 30.0, [Kind.BATTERY_LOW]), (7.0, 30.1, [Kind.FALLEN]), (7.0, None, [])],
)
async def test_limits_hold_at_their_edges_for_what_is_measured(
    volts: float, tilt_deg: float | None, kinds: list[Kind]
) -> None:
    robot = started(wire=ELKAPOD, safety={"min_battery_v": 7, "max_tilt_deg": 30})
    half = radians(tilt_deg or 0) / 2
    orientation = (0.0,) * 4 if tilt_deg is None else (cos(half), sin(half), 0.0, 0.0)
    for _ in range(2):
        robot.conductor.measured(AT_REST._replace(voltage_v=volts, orientation_wxyz=orientation), robot.now_ns())
        await asyncio.sleep(0.2)
    assert [event.kind for event in robot.events() if event.kind in {Kind.BATTERY_LOW, Kind.FALLEN}] == kinds


# ---- the state


async def test_a_state_has_targets_besides_angles_and_only_another_setting_makes_another_configuration() -> None:
    robot = started(limits={"servos": {"31": {"max_speed_deg_s": 10}}})
    assert robot.states[-1].legs[2].age_ms is None
    robot.put(LEG_3, START)
    await asyncio.sleep(0.1)
    robot.put(LEG_3, leg("set", 95, 91, 92, source="anna"))
    await asyncio.sleep(0.1)
    robot.conductor.reports.publish()
    found = robot.states[-1].legs[2]
    first, *others = found.servos
    assert found.source == "anna"
    assert found.age_ms == pytest.approx(100, abs=0.1)
    assert 90 < (first.angle_deg or 0) < 95 == first.target_deg
    assert [(each.angle_deg, each.target_deg) for each in others] == [(91, 91), (92, 92)]
    assert not robot.states[-1].legs[0].running
    robot.conductor.reports.missing_endpoints = ("tcp/192.0.2.1:7447",)
    robot.conductor.reports.publish()
    before, after = [report for _, report in robot.reports if isinstance(report, ConfigReport)]
    assert before.config != after.config == robot.states[-1].config


# ---- the metrics page


def page_of(collector: Collector) -> str:
    registry = CollectorRegistry()
    registry.register(collector)
    return generate_latest(registry).decode()


def page(robot: Robot) -> str:
    return page_of(Numbers(robot.conductor))


def samples(robot: Robot) -> dict[str, float]:
    """Return the samples by name and first label."""
    found = [sample for family in text_string_to_metric_families(page(robot)) for sample in family.samples]
    return {" ".join((sample.name, *sample.labels.values())): sample.value for sample in found}


async def test_the_page_of_a_robot_that_measures_is_the_list_in_the_docs(monkeypatch: pytest.MonkeyPatch) -> None:
    other = started()
    robot = started(wire=ELKAPOD)
    names = {name for name, _, _ in documented("that measures")}
    assert not names & samples(other).keys()
    assert {name for name, _, _ in described(page(robot)) - described(page(other))} == names, "also before any answer"
    await asyncio.sleep(1)
    monkeypatch.setattr(Bus, "controller_alive", False)  # its wire has missed signs of life
    monkeypatch.setattr(Bus, "answered_ns", robot.now_ns())
    robot.conductor.measured(AT_REST, robot.now_ns())
    await asyncio.sleep(0.5)
    assert described(page(robot)) - described(page(other)) == documented("that measures")
    found = samples(robot)
    assert [found[f"hexapod_foot_force {leg}"] for leg in LEGS] == list(AT_REST.feet)
    assert found["hexapod_battery_volts"] == 7.5
    assert found["hexapod_battery_percent"] == 80
    assert found["hexapod_temperature_celsius"] == 31.5
    assert found["hexapod_tilt_degrees"] == 0
    assert found["hexapod_controller_alive"] == 0
    assert found["hexapod_controller_answer_age_seconds"] == pytest.approx(0.5)
    assert found["hexapod_controller_changes_total controller_silent"] == found["hexapod_falls_total"] == 0
    assert sum("controller_changes" in name for name in found) == 3


BOARD = PowerReport(interface="slcan", alive=True, supplied=(11, 63), confirmed=False, age_ms=40.0)
DRAWN = Telemetry(
    time=WALL,
    age_ms=3.0,
    servos={"11": ServoTelemetry(supplied=True, current_a=0.25), "12": ServoTelemetry(supplied=False)},
    supply=Supply(voltage_v=7.3, current_a=0.25),
)


class Board(Collector):
    """The metrics of one board."""

    def __init__(self, power: PowerReport, measured: Telemetry | None, *events: Kind) -> None:
        self._found = power, measured, Counter(events)

    def collect(self) -> Iterator[Metric]:
        yield from powered(*self._found)


async def test_the_page_of_a_robot_with_a_power_board_is_the_list_in_the_docs() -> None:
    assert described(page_of(Board(BOARD, DRAWN))) == documented("with a power board")
    before = described(page_of(Board(PowerReport(interface="slcan", alive=False), None)))
    assert {name for name, _, _ in before} == {name for name, _, _ in documented("with a power board")}


@pytest.mark.parametrize(
    ("host", "origin", "may"),
    [
        *((host, None, True) for host in ("127.0.0.1:9464", "LocalHost:1", "[::1]:9464", "[::1]")),
        ("localhost.evil.example:9464", None, False),
        ("localhost, evil.example", None, False),
        (None, None, False),
        ("localhost:8765", "http://localhost:8765", True),
        ("localhost:8765", "https://evil.example", False),
        ("localhost:8765", "", False),
        ("evil.example:8765", "http://evil.example:8765", False),
    ],
)
def test_a_host_is_compared_whole_and_no_page_may_ask_but_ours(host: str | None, origin: str | None, may: bool) -> None:
    assert may_ask(host, origin, LOOPBACK) is may


# ---- the black box


async def test_the_black_box_has_what_was_measured_ten_times_a_second_at_most(folder: Path) -> None:
    robot = recorded(folder, wire=ELKAPOD)
    for number in range(100):  # 2 s
        robot.conductor.measured(AT_REST._replace(temperature_c=float(number)), robot.now_ns())
        await asyncio.sleep(0.02)
    found = contents(folder, Measured)
    assert found[0] == AT_REST._replace(temperature_c=0.0), "every value as it came"
    assert 16 <= len(found) <= 20
    assert [each.temperature_c for each in found] == sorted({each.temperature_c for each in found})
