"""The simulated controller of elkapod-2025: its two wires byte by byte, its servos, its battery, its faults."""

import math
import struct

import pytest

from gateway.host.shared_page import ServoPage
from gateway.model import elkapod
from gateway.model.elkapod import START, Measured
from gateway.simulation.elkapod import SimulatedBattery
from schemas.robot import SERVO_IDS
from tests.support.controllers import Elkapod

MS = 1_000_000  # ns
ALL = frozenset(SERVO_IDS)
WORKED_EXAMPLE = bytes.fromhex(
    "7e0000a0420000a2420000a4420000a6420000a8420000aa420000ac420000ae420000b0420000b2420000b4420000b6420000b8420000ba"
    "420000bc420000be420000c0420000c2420000000000000f"
)
"""80, 81, … 97 degrees."""
TARGETS = {servo_id: 80.0 + place for place, servo_id in enumerate(SERVO_IDS)}


def frame_of(angles_deg: dict[int, float]) -> bytes:
    """A frame with any numbers, legal or not; 90 degrees for the others."""
    return struct.pack("<B18f6xB", 0x7E, *(angles_deg.get(servo_id, 90.0) for servo_id in SERVO_IDS), 0x0F)


class Bench:
    """A controller, its clock, the page of where its servos are sent, and what it said."""

    def __init__(self, battery: SimulatedBattery | None = None) -> None:
        self.now_ns = 7_000_000 * MS
        self.said: list[str] = []
        self.page = ServoPage()
        self.controller = Elkapod(
            clock=lambda: self.now_ns, on_change=self.said.append, page=self.page, battery=battery
        )

    def exchange(self, data: bytes = WORKED_EXAMPLE, after_ms: int = 20) -> bytes:
        self.now_ns += after_ms * MS
        return self.controller.exchange(data)

    def measured(self, data: bytes = WORKED_EXAMPLE, after_ms: int = 20) -> Measured:
        return elkapod.measured(self.exchange(data, after_ms))

    def targets(self) -> dict[int, float | None]:
        return {servo_id: servo.target_deg for servo_id, servo in self.controller.servos.items()}

    def started(self) -> "Bench":
        self.exchange()
        self.controller.uart_write(START)
        assert self.controller.energised == ALL
        return self


@pytest.fixture
def bench() -> Bench:
    return Bench()


# ---- start, shutdown and what is between


def test_a_start_before_any_frame_waits_for_one_and_is_counted(bench: Bench) -> None:
    bench.controller.uart_write(START)
    assert bench.controller.corruptions == {"started before any frame": 1}
    assert set(bench.page.read().values()) == {None}
    bench.exchange()
    assert bench.page.read() == TARGETS


def test_angles_that_no_servo_has_are_driven_to_its_end_and_counted(bench: Bench) -> None:
    bench.started()
    bench.exchange(frame_of({**TARGETS, 11: -20.0, 12: 1e9, 13: math.inf, 21: math.nan}))
    assert [bench.targets()[servo_id] for servo_id in (11, 12, 13, 21)] == [0.0, 180.0, 180.0, 83.0]
    assert sum(bench.controller.corruptions.values()) == 4
