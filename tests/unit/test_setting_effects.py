"""Each setting changes behaviour: with another value, something else happens. `test_none_is_forgotten` keeps the list.

What needs a kernel device, a network or a terminal is shown there: `spi.device` and `spi.speed_hz` in tests/hil, the
Zenoh settings with a running service in test_service.py.
"""

import asyncio
import re
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from gateway.model.frames import Framing, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.rules import Rules
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from gateway.robot.spi import Batch
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.guard import IllegalTransferError
from gateway.simulation.controller import SimulatedController
from schemas.robot import LEGS
from tests.support.controllers import Controller
from tests.support.robot import LEG_3, START, leg, started_and_quiet

pytestmark = pytest.mark.virtual_time

SHOWN_ELSEWHERE = {
    "zenoh.listen": "test_service.py",
    "zenoh.config": "test_service.py",
    "zenoh.allow_insecure": "test_exposure.py",
    "wire.name": "test_elkapod_conductor.py",
    "wire.options": "test_plugin.py",
    "spi.device": "hil/test_service.py",
    "spi.speed_hz": "hil/test_service.py",
    "controller.uart": "hil/test_elkapod.py",
    "buttons.names": "test_lease.py",
    "state.path": "zenoh/test_calibration.py",
    "telemetry.metrics": "test_reports.py",
    "power.interface": "hil/test_power.py",
    "power.channel": "hil/test_power.py",
    "power.servos": "test_power_line.py",
    "power.confirm_ms": "test_power_board.py",
}

MS = 1_000_000


def test_where_nothing_is_set_the_supervisor_has_its_own_defaults() -> None:
    """But for these: tests of other rules have starts leave at once, and servos go straight to their targets."""
    assert rules(Settings()) == Rules(start_wait_ns=START_WAIT_NS, start_pause_ns=15 * MS, takeover_cdeg_s=180_00)


@pytest.mark.parametrize(
    ("sections", "pause_ms"),
    [
        ({}, 15),
        ({"power": {"interface": "sim"}}, 0),
        ({"power": {"interface": "sim"}, "limits": {"start_stagger_ms": 15}}, 15),
        ({"wire": {"name": "elkapod-2025"}}, 0),
        ({"wire": {"name": "elkapod-2025"}, "power": {"interface": "sim"}}, 0),
        ({"limits": {"start_stagger_ms": 0}}, 0),
    ],
)
def test_legs_start_in_turn_unless_a_board_or_the_wire_sees_to_it(sections: dict[str, Any], pause_ms: float) -> None:
    assert rules(Settings.of(sections)).start_pause_ns == pause_ms * MS


RULES: list[tuple[str, object, dict[str, object]]] = [
    ("limits.leg_rate_hz", 100, {"period_ns": 10 * MS}),
    ("limits.leg_rate_hz", 3, {"period_ns": 333_333_334}),
    ("limits.start_stagger_ms", 30, {"start_pause_ns": 30 * MS}),
    ("limits.takeover_deg_s", 90.5, {"takeover_cdeg_s": 90_50}),
    ("limits.takeover_deg_s", 0.001, {"takeover_cdeg_s": 1}),
    ("limits.takeover_deg_s", 0, {"takeover_cdeg_s": 0}),
    ("limits.servos", {"32": {"min_deg": 20}, "11": {"max_deg": 45.5, "max_speed_deg_s": 60}},
     {"joint_limits_cdeg": {32: (20_00, 180_00), 11: (0, 45_50)}, "max_speed_cdeg_s": {11: 60_00}}),
    ("limits.servos", {"32": {"max_speed_deg_s": 0.001}},
     {"joint_limits_cdeg": {32: (0, 180_00)}, "max_speed_cdeg_s": {32: 1}}),
    ("spi.framing", "length-prefixed", {"avoid_cdeg": (1_00, 4_00)}),
    ("spi.framing", "plain", {}),
    ("watchdog.timeout_ms", 20, {"timeout_ns": 20 * MS}),
    ("watchdog.scope", "robot", {"whole_robot": True}),
    ("watchdog.landing_ms", 500, {"landing_ns": 500 * MS}),
    ("watchdog.landing", {"31": 30.5}, {"landing_cdeg": {31: 30_50}}),
    ("lease.required", True, {"lease_required": True}),
    ("lease.ttl_ms", 300, {"lease_ttl_ns": 300 * MS}),
    ("buttons.required", 2, {"buttons_required": 2}),
    ("buttons.timeout_ms", 500, {"buttons_timeout_ns": 500 * MS}),
    ("safety.min_battery_v", 7, {"min_battery_mv": 7000}),
    ("safety.max_tilt_deg", 30.5, {"max_tilt_cdeg": 30_50}),
]  # fmt: skip
"""A setting, a value, and what it changes in the supervisor's rules. What a rule does is shown at the supervisor."""


@pytest.mark.parametrize(("setting", "value", "changed"), RULES)
def test_a_setting_is_a_rule(setting: str, value: object, changed: dict[str, Any]) -> None:
    section, _, name = setting.partition(".")
    measures = {"wire": {"name": "elkapod-2025"}} if section == "safety" else {}
    before = rules(Settings.of(measures))
    assert rules(Settings.of({**measures, section: {name: value}})) == replace(before, **changed)


async def test_max_age_ms() -> None:
    for max_age_ms, accepted in ((0, True), (100, False), (1000, True)):
        robot = await started_and_quiet(limits={"max_age_ms": max_age_ms})
        robot.put(LEG_3, leg("start", 1, 1, 1, sent_ms=500))
        await asyncio.sleep(0.2)
        assert robot.ask(LEG_3, leg("set", 2, 2, 2, sent_ms=501)).accepted is accepted


@pytest.mark.parametrize("frames", [False, True])
async def test_frames(frames: bool) -> None:
    robot = await started_and_quiet(telemetry={"frames": frames})
    robot.put(LEG_3, START)
    assert len(robot.records) == frames


class Batches(SimulatedController):
    """Keeps the batches that it is given."""

    def __init__(self) -> None:
        super().__init__(Framing.PLAIN)
        self.batches: list[Batch] = []

    def transfer(self, batch: Batch) -> None:
        self.batches.append(tuple(batch))
        super().transfer(batch)


@pytest.mark.parametrize(("frame_gap_us", "pause_us"), [(0, 0), (0.1, 1), (100, 100), (999.5, 1000)])
def test_frame_gap_us(frame_gap_us: float, pause_us: int) -> None:
    settings = Settings.of({"spi": {"frame_gap_us": frame_gap_us}})
    controller = Batches()
    bus = Bus(settings.spi, lambda: controller)
    bus.open()
    bus.write([stop_leg(number) for number in LEGS])
    assert [[each[1] for each in batch] for batch in controller.batches] == [[pause_us] * 6]


@pytest.mark.parametrize(("framing", "written"), [("length-prefixed", False), ("plain", True)])
def test_the_guard_knows_them(framing: str, written: bool) -> None:
    settings = Settings.of({"spi": {"framing": framing, "frame_gap_us": 20}})
    controller = Controller(settings.spi.framing)
    bus = Bus(settings.spi, lambda: controller)
    bus.open()
    frame = OneServo(11, ServoOp(Op.SET, 1_99))
    with nullcontext() if written else pytest.raises(IllegalTransferError):
        bus.write([frame])
    assert (frame.data in [data for _, data in controller.transfers]) is written


@pytest.mark.parametrize(("speed_hz", "sizes"), [(2_500_000, [6]), (500_000, [3, 3])])
def test_speed_hz(speed_hz: int, sizes: list[int]) -> None:
    """A slower clock makes frames longer, and a call that moves takes a millisecond at most."""
    controller = Batches()
    bus = Bus(Settings.of({"spi": {"speed_hz": speed_hz}}).spi, lambda: controller)
    bus.open()
    bus.write([OneLeg(leg, (ServoOp(Op.SET, 90_00),) * 3) for leg in LEGS])
    assert [len(batch) for batch in controller.batches] == sizes


def test_none_is_forgotten() -> None:
    here = set(re.findall(r"^(?:async )?def test_(\w+)", Path(__file__).read_text(), re.MULTILINE))
    shown_here = {part for name in here for part in name.split("_and_")}
    shown = {*SHOWN_ELSEWHERE, *(setting for setting, _, _ in RULES)}
    for name in (f"{section}.{each}" for section, table in asdict(Settings()).items() for each in table):
        assert name.partition(".")[2] in shown_here or name in shown, f"nothing shows what {name} does"
