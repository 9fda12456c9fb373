"""Each setting changes behaviour: with another value, something else happens. `test_none_is_forgotten` keeps the list.

What needs a kernel device, a network or a terminal is shown there: `spi.device` and `spi.speed_hz` in tests/hil, the
Zenoh settings with a running service in test_service.py.
"""

import asyncio
import math
import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from gateway.model.elkapod import Measured, answer
from gateway.model.frames import OneServo, Op, ServoOp, stop_leg
from gateway.model.framing import Framing
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.leg import Rules
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from gateway.robot.spi import Batch
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.guard import IllegalTransferError
from gateway.robot.spi.simulator import SimulatedController
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Reason
from tests.support.elkapod import all_legs, elkapod
from tests.support.robot import leg, servo, started_and_quiet

pytestmark = pytest.mark.virtual_time

LEG_1, LEG_3 = keys.leg_command(1), keys.leg_command(3)
START = leg("start", 90, 90, 90)
SHOWN_ELSEWHERE = {
    "zenoh.listen": "test_service.py",
    "zenoh.config": "test_service.py",
    "zenoh.allow_insecure": "test_exposure.py",
    "spi.protocol": "test_elkapod_conductor.py",
    "spi.device": "hil/test_service.py",
    "spi.speed_hz": "hil/test_service.py",
    "spi.framing": "test_bus.py",
    "controller.uart": "hil/test_elkapod.py",
    "watchdog.scope": "test_conductor.py",
    "lease.required": "test_lease_conductor.py",
    "lease.ttl_ms": "test_lease_conductor.py",
    "buttons.required": "test_buttons_conductor.py",
    "buttons.timeout_ms": "test_buttons_conductor.py",
    "buttons.names": "test_buttons_conductor.py",
    "state.path": "zenoh/test_calibration.py",
    "telemetry.metrics": "test_metrics.py",
    "power.interface": "hil/test_power.py",
    "power.channel": "hil/test_power.py",
    "power.servos": "test_power_line.py",
    "power.confirm_ms": "test_power_board.py",
}


def test_where_nothing_is_set_the_supervisor_has_its_own_defaults() -> None:
    """But that starts without `sent_ms` wait: tests of single rules have these leave at once."""
    assert rules(Settings()) == Rules(start_wait_ns=START_WAIT_NS)


@pytest.mark.parametrize(("leg_rate_hz", "frames"), [(1, 4), (10, 13), (50, 53), (100, 101)])
async def test_leg_rate_hz(leg_rate_hz: float, frames: int) -> None:
    robot = await started_and_quiet(limits={"leg_rate_hz": leg_rate_hz})
    robot.put(LEG_3, START)
    for count in range(100):
        await asyncio.sleep(0.01)
        robot.put(LEG_3, leg("set", count, 0, 0))
    assert len([frame for _, frame in robot.frames if frame.leg == 3]) == frames


async def test_max_age_ms() -> None:
    for max_age_ms, accepted in ((0, True), (100, False), (1000, True)):
        robot = await started_and_quiet(limits={"max_age_ms": max_age_ms})
        robot.put(LEG_3, leg("start", 1, 1, 1, sent_ms=500))
        await asyncio.sleep(0.2)
        assert robot.ask(LEG_3, leg("set", 2, 2, 2, sent_ms=501)).accepted is accepted


@pytest.mark.parametrize("start_stagger_ms", [0, 30])
async def test_start_stagger_ms(start_stagger_ms: float) -> None:
    robot = await started_and_quiet(limits={"start_stagger_ms": start_stagger_ms})
    robot.put(keys.LEGS_COMMAND, {"legs": {str(number): START for number in LEGS}})
    await asyncio.sleep(0.24)
    times_ms = [at_ms for at_ms, _ in robot.frames]
    assert times_ms == pytest.approx([times_ms[0] + start_stagger_ms * index for index in range(6)], abs=0.01)


async def test_servos() -> None:
    limits = {"32": {"min_deg": 20, "max_deg": 160}, "11": {"max_deg": 45.5}}
    robot = await started_and_quiet(limits={"servos": limits})
    ack = robot.ask(LEG_3, leg("start", 0, 19.99, 180))
    assert (ack.reason, ack.detail) == (
        Reason.JOINT_LIMIT,
        "servo 32 may go from 20 to 160 degrees; 19.99 is outside",
    )
    assert robot.frames == [], "the whole command is rejected"
    assert robot.ask(keys.servo_command(11), servo("start", 45.51)).reason == Reason.JOINT_LIMIT
    assert robot.ask(keys.servo_command(11), servo("start", 45.5)).accepted
    assert robot.ask(LEG_3, leg("start", 0, 20, 180)).accepted
    await asyncio.sleep(0.1)
    assert robot.ask(LEG_3, leg("set", 0, 160.01, 180)).reason == Reason.JOINT_LIMIT
    assert robot.ask(LEG_3, leg("stop")).accepted


@pytest.mark.parametrize(("speed", "first_deg", "last_deg"), [(0, 100, 100), (60, 91.2, 97.8), (50, 91, 96.5)])
async def test_max_speed_deg_s(speed: float, first_deg: float, last_deg: float) -> None:
    robot = await started_and_quiet(limits={"servos": {"31": {"max_speed_deg_s": speed}}})
    assert robot.ask(LEG_3, START).accepted
    await asyncio.sleep(0.05)
    assert robot.ask(keys.servo_command(31), servo("set", 100)).accepted
    assert robot.conductor.state().legs[2].servos[0].target_deg == 100
    assert robot.conductor.state().legs[2].servos[0].angle_deg == pytest.approx(first_deg, abs=0.01)
    await asyncio.sleep(0.11)
    assert robot.conductor.state().legs[2].servos[0].angle_deg == pytest.approx(last_deg, abs=0.6)


@pytest.mark.parametrize(
    ("spi", "angle_deg", "accepted"),
    [
        ({"framing": "length-prefixed"}, 3.99, False),
        ({"framing": "length-prefixed"}, 1, False),
        ({"framing": "length-prefixed"}, 0.99, True),
        ({"framing": "length-prefixed"}, 4, True),
        ({"framing": "plain"}, 2, True),
    ],
)
async def test_angles_that_are_not_sent(spi: dict[str, object], angle_deg: float, accepted: bool) -> None:
    robot = await started_and_quiet(spi=spi)
    ack = robot.ask(LEG_3, leg("start", 90, 90, angle_deg))
    assert (ack.accepted, ack.reason) == (accepted, None if accepted else Reason.JOINT_LIMIT)


@pytest.mark.parametrize(("landing_ms", "landing_deg"), [(0, 30), (500, 30), (500, 120)])
async def test_landing_ms_and_landing(landing_ms: float, landing_deg: float) -> None:
    robot = await started_and_quiet(
        watchdog={"landing_ms": landing_ms, "landing": {"31": landing_deg}}, rules={"repeats": 0}
    )
    began = len(robot.frames)
    robot.put(LEG_3, START)
    await asyncio.sleep(1)
    times_ms = [at_ms for at_ms, _ in robot.frames[began:]]
    assert times_ms[-1] - times_ms[0] == pytest.approx(250 + landing_ms, abs=1)
    told = [frame.command.angle_cdeg for _, frame in robot.frames[began:] if isinstance(frame, OneServo)]
    assert told[-1:] == ([landing_deg * 100] if landing_ms else [])


@pytest.mark.parametrize("timeout_ms", [20, 250, 1000])
async def test_timeout_ms(timeout_ms: float) -> None:
    robot = await started_and_quiet(watchdog={"timeout_ms": timeout_ms}, rules={"repeats": 0})
    robot.put(LEG_3, START)
    await asyncio.sleep(timeout_ms / 1000 + 0.5)
    begun_ms, stopped_ms = [at_ms for at_ms, frame in robot.frames if frame.leg == 3]
    assert stopped_ms - begun_ms == pytest.approx(timeout_ms, abs=0.01)
    assert robot.conductor.state().watchdog.timeout_ms == timeout_ms


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
    settings = Settings.model_validate({"spi": {"frame_gap_us": frame_gap_us}})
    controller = Batches()
    bus = Bus(settings.spi, lambda: controller)
    bus.open()
    bus.write([stop_leg(number) for number in LEGS])
    assert [[each[1] for each in batch] for batch in controller.batches] == [[pause_us] * 6]


@pytest.mark.parametrize(
    ("spi", "written"),
    [
        ({"framing": "length-prefixed"}, False),
        ({"framing": "plain"}, True),
    ],
)
def test_the_guard_knows_them(spi: dict[str, object], written: bool) -> None:
    settings = Settings.model_validate({"spi": {**spi, "frame_gap_us": 20}})
    controller = SimulatedController(settings.spi.framing)
    bus = Bus(settings.spi, lambda: controller)
    bus.open()
    frame = OneServo(11, ServoOp(Op.SET, 1_99))
    with nullcontext() if written else pytest.raises(IllegalTransferError):
        bus.write([frame])
    assert (frame.to_bytes() in [data for _, data in controller.transfers]) is written


@pytest.mark.parametrize(("speed_hz", "last_ns"), [(2_500_000, 44_800), (1_000_000, 112_000)])
def test_speed_hz(speed_hz: int, last_ns: int) -> None:
    """It says where a frame's place on the wire is."""
    settings = Settings.model_validate({"spi": {"speed_hz": speed_hz}})
    now_ns = iter((0, 0, 10**8))
    bus = Bus(settings.spi, Batches, clock=lambda: next(now_ns))
    bus.open()
    assert [sent.ns for sent in bus.write([stop_leg(1)]).sent] == [last_ns]


def test_none_is_forgotten() -> None:
    def names(model: type[BaseModel], prefix: str = "") -> set[str]:
        found: set[str] = set()
        for name, field in model.model_fields.items():
            inner: Any = field.annotation
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                found |= names(inner, f"{prefix}{name}.")
            else:
                found.add(prefix + name)
        return found

    here = set(re.findall(r"^(?:async )?def test_(\w+)", Path(__file__).read_text(), re.MULTILINE))
    shown_here = {part for name in here for part in name.split("_and_")}
    for name in names(Settings):
        assert name.partition(".")[2] in shown_here or name in SHOWN_ELSEWHERE, f"nothing shows what {name} does"


@pytest.mark.parametrize("silent_ms", [300, 1000])
async def test_silent_ms(silent_ms: float) -> None:
    robot = await elkapod(controller={"silent_ms": silent_ms})
    robot.elkapod.silent = True
    await asyncio.sleep(silent_ms / 1e3 - 0.1)
    assert robot.events(Kind.CONTROLLER_SILENT) == []
    await asyncio.sleep(0.2)
    assert len(robot.events(Kind.CONTROLLER_SILENT)) == 1


@pytest.mark.parametrize(("min_battery_v", "reason"), [(0, None), (7, None), (9, Reason.BATTERY_LOW)])
async def test_min_battery_v(min_battery_v: float, reason: Reason | None) -> None:
    """A full one has 8.4 V."""
    robot = await elkapod(safety={"min_battery_v": min_battery_v})
    assert robot.ask(keys.LEGS_COMMAND, all_legs("start", 90)).reason == reason


@pytest.mark.parametrize(("max_tilt_deg", "falls"), [(0, False), (40, False), (30.2, False), (29.8, True), (20, True)])
async def test_max_tilt_deg(max_tilt_deg: float, falls: bool) -> None:
    robot = await elkapod(safety={"max_tilt_deg": max_tilt_deg})
    assert robot.ask(keys.LEGS_COMMAND, all_legs("start", 90)).accepted
    half = math.radians(30) / 2
    tilted = Measured(25, 8, 80, (math.cos(half), math.sin(half), 0, 0), (0, 0, 0), (0, 0, 9.81), (0,) * 6)
    robot.elkapod.garbage = answer(tilted)
    await asyncio.sleep(0.24)  # less than its leg may be silent, and more than a tilt may last
    assert bool(robot.events(Kind.FALLEN)) is falls
    assert bool(robot.elkapod.energised) is not falls
