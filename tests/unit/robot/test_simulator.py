"""The simulated controller against what was measured with the published firmware, on a virtual clock."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.host.shared_page import ServoPage
from gateway.model import elkapod
from gateway.model.elkapod import START, Measured
from gateway.model.frames import OneLeg, Op, ServoOp
from gateway.model.framing import Framing
from gateway.model.power_board import CanFrame
from gateway.robot.power.currents import IDLE_MA
from gateway.simulation.board_port import HOLDS_MA, WAITS_MA, SimulatedAdapter, SimulatedDraw, frame_of
from gateway.simulation.controller import ServoState
from gateway.simulation.elkapod import SimulatedBattery
from schemas.robot import SERVO_IDS
from tests.fuzz.targets import PAUSES_NS, fuzz_simulator
from tests.support.controllers import Controller, Elkapod
from tests.support.transfers import on_wire
from tests.unit.model.test_frames import bytes_near_a_frame, frames

MS = 1_000_000  # ns
START_11 = bytes.fromhex("06 02 0b 01 5a 00")
STOP_11 = bytes.fromhex("06 02 0b 02 00 00")


class Bench:
    """A controller, its clock, and what it said."""

    def __init__(self, framing: Framing, *, tick_phase_ns: int = 0) -> None:
        self.framing = framing
        self.now_ns = 5_000_000 * MS
        self.said: list[str] = []
        self.controller = Controller(
            framing,
            clock=lambda: self.now_ns,
            on_change=self.said.append,
            tick_phase_ns=tick_phase_ns,
        )

    def transfer(self, *transfers: str | bytes) -> None:
        for data in transfers:
            self.controller.take(bytes.fromhex(data) if isinstance(data, str) else data)

    def send(self, *sent: bytes) -> None:
        for frame in sent:
            self.transfer(*on_wire(self.framing, frame))

    def servo(self, servo_id: int) -> ServoState:
        return self.controller.servos[servo_id]


@pytest.fixture
def plain() -> Bench:
    return Bench(Framing.PLAIN)


@pytest.fixture
def prefixed() -> Bench:
    return Bench(Framing.LENGTH_PREFIXED)


# ---- one stream of bytes, in and out of sync


@given(
    st.sampled_from(Framing),
    st.lists(
        st.tuples(
            st.sampled_from(range(len(PAUSES_NS))),
            frames.map(lambda frame: frame.to_bytes())
            | bytes_near_a_frame
            | st.sampled_from([b"\6", b"\x0e", b"\x5a", bytes(16), bytes(70)]),
        ),
        max_size=20,
    ),
)
def test_whatever_comes_it_does_what_a_second_reading_of_the_firmware_does(
    framing: Framing, sent: list[tuple[int, bytes]]
) -> None:
    """As the fuzzer compares them; whole frames, lengths and zeros get further than bytes at random."""
    fuzz_simulator(
        bytes((framing is Framing.LENGTH_PREFIXED,))
        + b"".join(bytes((pause, len(data))) + data for pause, data in sent)
    )


# ---- memory corruption


def test_of_256_ids_these_five_kill_and_no_other(plain: Bench) -> None:
    died = set()
    for servo_id in range(256):
        frame = bytes((6, 2, servo_id, 1, 90, 0))
        bench = Bench(Framing.LENGTH_PREFIXED)
        bench.send(frame)
        plain.send(frame)
        if bench.controller.dead is not None:
            died.add(servo_id)
    assert died == {0, 1, 2, 3, 10}
    assert plain.controller.dead is None


@pytest.mark.parametrize("length", [69, 90, 255])
def test_lengths_of_69_to_255_leave_it_deaf_for_good_once_68_bytes_have_come(prefixed: Bench, length: int) -> None:
    """Two bare frames announce 90 bytes, which its timeout still ends; fifteen are too many."""
    prefixed.send(START_11)
    prefixed.transfer(bytes((length,)))
    prefixed.transfer(bytes(68))
    assert prefixed.controller.dead is None
    prefixed.transfer(b"\0")
    assert prefixed.controller.dead == "69 bytes in a buffer of 64 overwrote its SPI handle"
    prefixed.now_ns += 5_000 * MS
    prefixed.send(STOP_11)
    assert prefixed.controller.energised == {11}


def test_five_bytes_lost_of_leg_3_start_a_servo_that_nobody_started(prefixed: Bench) -> None:
    """`0e 01`, which announces and begins leg 4's Set, is taken for id 14 with operation Start."""
    sets = [OneLeg(leg, (ServoOp(Op.SET, 90_00),) * 3).to_bytes() for leg in (3, 4)]
    prefixed.send(*[OneLeg(leg, (ServoOp(Op.START, 90_00),) * 3).to_bytes() for leg in (3, 4)])
    stream = b"".join(on_wire(Framing.LENGTH_PREFIXED, *sets))
    started: set[int] = set()
    for first in range(len(stream) // 2 - 5 + 1):
        bench = Bench(Framing.LENGTH_PREFIXED)
        bench.transfer(stream[:first] + stream[first + 5 :])
        started |= bench.controller.energised
    assert started == {21}


# ---- The simulated CAN adapter: slcan byte by byte, and the faults between it and the board


@pytest.fixture
def adapter() -> SimulatedAdapter:
    """With an open channel."""
    adapter = SimulatedAdapter()
    assert adapter.take(b"C\rS8\r\rO\r") == ([], b"\r\r\r\r")
    return adapter


@pytest.mark.parametrize(
    "line",
    [
        "t06A",
        "t06A3",
        "t06A303FF",
        "t06A303FFFFFF",
        "t06A9" + 18 * "0",
        "t8000",
        "txyz0",
        "t06A3gg0000",
        "x",
        "t06A2 03 FF",
    ],
)
def test_a_line_that_is_none_puts_nothing_on_the_bus(adapter: SimulatedAdapter, line: str) -> None:
    assert adapter.take(line.encode() + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")
    assert frame_of(line.encode()) is None


def test_bytes_come_in_any_portions_and_an_endless_line_does_no_harm(adapter: SimulatedAdapter) -> None:
    assert [adapter.take(bytes((byte,)))[0] for byte in b"t0700\r"] == [[]] * 5 + [[CanFrame(0x70)]]
    assert adapter.take(b"0" * 100_000 + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")


# ---- What simulated servos draw: waiting, holding, moving, and under the torques of a simulated body


OFF: dict[int, float | None] = dict.fromkeys(SERVO_IDS)


def test_one_that_is_driven_holds_and_takes_more_until_it_is_there() -> None:
    draw = SimulatedDraw()
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 0) == {**dict.fromkeys(SERVO_IDS, WAITS_MA), 21: 450.0}
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 84 * MS)[21] == 450.0, "30 degrees take 85 ms"
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 86 * MS)[21] == HOLDS_MA
    assert draw.draw_ma({**OFF, 21: 61.0}, (), 100 * MS)[21] == 450.0
    assert draw.draw_ma(OFF, (), 101 * MS)[21] == WAITS_MA


def test_one_that_holds_though_it_was_stopped_draws_more_than_a_stopped_one_may() -> None:
    assert WAITS_MA < IDLE_MA < HOLDS_MA


def test_a_bodys_torques_decide() -> None:
    torques_nm = [0.0] * 18
    torques_nm[SERVO_IDS.index(22)] = -2.0
    drawn = SimulatedDraw().draw_ma(dict.fromkeys(SERVO_IDS, 90.0) | {63: None}, torques_nm, 0)
    assert drawn == {**dict.fromkeys(SERVO_IDS, 10.0), 22: pytest.approx(2510.0), 63: WAITS_MA}


# ---- The simulated controller of elkapod-2025: its two wires byte by byte, its servos, its battery, its faults


ALL = frozenset(SERVO_IDS)
WORKED_EXAMPLE = bytes.fromhex(
    "7e0000a0420000a2420000a4420000a6420000a8420000aa420000ac420000ae420000b0420000b2420000b4420000b6420000b8420000ba"
    "420000bc420000be420000c0420000c2420000000000000f"
)
"""80, 81, … 97 degrees."""
TARGETS = {servo_id: 80.0 + place for place, servo_id in enumerate(SERVO_IDS)}


def any_frame(angles_deg: dict[int, float]) -> bytes:
    """A frame with any numbers, legal or not; 90 degrees for the others."""
    return struct.pack("<B18f6xB", 0x7E, *(angles_deg.get(servo_id, 90.0) for servo_id in SERVO_IDS), 0x0F)


class ElkapodBench:
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

    def started(self) -> "ElkapodBench":
        self.exchange()
        self.controller.uart_write(START)
        assert self.controller.energised == ALL
        return self


@pytest.fixture
def elkapod_bench() -> ElkapodBench:
    return ElkapodBench()


# ---- start, shutdown and what is between


def test_a_start_before_any_frame_waits_for_one_and_is_counted(elkapod_bench: ElkapodBench) -> None:
    elkapod_bench.controller.uart_write(START)
    assert elkapod_bench.controller.corruptions == {"started before any frame": 1}
    assert set(elkapod_bench.page.read().values()) == {None}
    elkapod_bench.exchange()
    assert elkapod_bench.page.read() == TARGETS


def test_angles_that_no_servo_has_are_driven_to_its_end_and_counted(elkapod_bench: ElkapodBench) -> None:
    elkapod_bench.started()
    elkapod_bench.exchange(any_frame({**TARGETS, 11: -20.0, 12: 1e9, 13: math.inf, 21: math.nan}))
    assert [elkapod_bench.targets()[servo_id] for servo_id in (11, 12, 13, 21)] == [0.0, 180.0, 180.0, 83.0]
    assert sum(elkapod_bench.controller.corruptions.values()) == 4
