"""The simulated controller and power board against what was measured with the firmware, on a virtual clock."""

import math
import struct
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.host.shared_page import ServoPage
from gateway.model.elkapod import START
from gateway.model.frames import Framing
from gateway.model.power_board import CanFrame
from gateway.robot.runtime.supply import IDLE_MA
from gateway.simulation.board import MEASURE_NS, PASS_NS, SimulatedBoard
from gateway.simulation.board_port import HOLDS_MA, WAITS_MA, SimulatedAdapter, SimulatedDraw, frame_of
from gateway.simulation.controller import pulse_us
from schemas.robot import SERVO_IDS
from tests.support.controllers import Controller, Elkapod, on_wire
from tests.unit.model.test_frames import bytes_near_a_frame, frames

MS = 1_000_000  # ns
UP_TO_THE_HANDLE = 68


class ReferenceController:
    """The published firmware's receiver once more, byte by byte: which servos are energised, and at which pulse.

    It shares only the pulse widths with `SimulatedController`; they have vectors of their own.
    """

    def __init__(self, *, announced: bool) -> None:
        self.announced = announced
        self.energised: set[int] = set()
        self.pulses: dict[int, int] = {}
        self.executed = 0
        self.dead = False
        self._heard: list[int] | None = None  # None: waiting for a length
        self._wanted = 0
        self._since_tick = 0

    def transfer(self, data: bytes, now_ns: int) -> None:
        if self._heard is not None and now_ns // MS - self._since_tick >= 1000:
            if self.announced:
                self._execute(self._heard + [0] * (self._wanted - len(self._heard)))
            self._heard = None
        for byte in data:
            if self.dead:
                return
            if self._heard is not None:
                self._heard.append(byte)
            elif byte:
                self._heard = [] if self.announced else [byte]
                self._wanted, self._since_tick = byte, now_ns // MS
            if self.announced and self._heard is not None and len(self._heard) > UP_TO_THE_HANDLE:
                self.dead, self._heard = True, None
            if self._heard is not None and len(self._heard) == self._wanted:
                self._execute(self._heard)
                self._heard = None

    def _execute(self, body: list[int]) -> None:
        if (len(body), body[1:2]) not in ((6, [2]), (14, [1])):
            return
        for servo_id, op, whole, hundredths in (body[start : start + 4] for start in range(2, len(body), 4)):
            if self.announced and servo_id in (0, 1, 2, 3, 10) and op in (1, 2, 3):
                self.dead = True  # a bus fault
                return
            index = ((servo_id // 10 - 1) * 3 + servo_id % 10 - 1) % 256
            past = {18: 11, 23: 21} if self.announced else {}
            if index >= len(SERVO_IDS) and index not in past:
                continue
            driven = SERVO_IDS[index] if index < len(SERVO_IDS) else past[index]
            if op == 2:
                self.energised.discard(driven)
            if op == 1:
                self.energised.add(driven)
            if op in (1, 3):
                self.pulses[driven] = pulse_us(whole, hundredths)
        self.executed += 1


# ---- one stream of bytes, in and out of sync


@given(
    st.sampled_from(Framing),
    st.lists(
        st.tuples(
            st.sampled_from([0, 1, MS, 400 * MS, 1000 * MS - 1, 1000 * MS, 3000 * MS]),
            frames.map(lambda frame: frame.data)
            | bytes_near_a_frame
            | st.sampled_from([b"\6", b"\x0e", b"\x5a", bytes(16), bytes(70)]),
        ),
        max_size=20,
    ),
)
def test_whatever_comes_it_does_what_a_second_reading_of_the_firmware_does(
    framing: Framing, sent: list[tuple[int, bytes]]
) -> None:
    """Whole frames, lengths and zeros get further than bytes at random."""
    now_ns = 0
    controller = Controller(framing, clock=lambda: now_ns)
    reference = ReferenceController(announced=framing is Framing.LENGTH_PREFIXED)
    for pause_ns, data in sent:
        now_ns += pause_ns
        controller.take(data)
        reference.transfer(data, now_ns)
    servos = controller.servos
    assert {servo_id for servo_id, servo in servos.items() if servo.energised} == reference.energised
    assert {servo_id: servo.pulse_us for servo_id, servo in servos.items() if servo.pulse_us} == reference.pulses
    assert tuple(servos) == SERVO_IDS
    assert all(0 <= servo.angle_deg <= 180 for servo in servos.values())
    assert (controller.executed, controller.dead is not None) == (reference.executed, reference.dead)
    assert len(controller.corruptions) <= 2 * 256


# ---- memory corruption


def test_of_256_ids_these_five_kill_and_no_other() -> None:
    died, plain = set(), Controller(Framing.PLAIN, clock=lambda: 0)
    for servo_id in range(256):
        frame = bytes((6, 2, servo_id, 1, 90, 0))
        controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda: 0)
        for data in on_wire(Framing.LENGTH_PREFIXED, frame):
            controller.take(data)
        plain.take(frame)
        if controller.dead is not None:
            died.add(servo_id)
    assert died == {0, 1, 2, 3, 10}
    assert plain.dead is None


@pytest.mark.parametrize("length", [69, 90, 255])
def test_lengths_of_69_to_255_leave_it_deaf_for_good_once_68_bytes_have_come(length: int) -> None:
    """Two bare frames announce 90 bytes, which its timeout still ends; fifteen are too many."""
    said: list[str] = []
    controller = Controller(Framing.LENGTH_PREFIXED, clock=lambda: 5_000_000 * MS, on_change=said.append)
    for data in (b"\6", bytes.fromhex("06 02 0b 01 5a 00"), bytes((length,)), bytes(68)):
        controller.take(data)
    assert controller.dead is None
    controller.take(b"\0")
    assert controller.dead == "69 bytes in a buffer of 64 overwrote its SPI handle"
    for data in (b"\6", bytes.fromhex("06 02 0b 02 00 00")):
        controller.take(data)
    assert controller.energised == {11}
    assert said, "it tells of its servo and of its end"


# ---- The simulated CAN adapter: slcan byte by byte, and the faults between it and the board


@pytest.mark.parametrize("line", ["t06A", "t06A303FFFFFF", "t06A9" + 18 * "0", "t8000", "t06A3gg0000", "x"])
def test_a_line_that_is_none_puts_nothing_on_the_bus(line: str) -> None:
    adapter = SimulatedAdapter()
    assert adapter.take(b"C\rS8\r\rO\r") == ([], b"\r\r\r\r")
    assert adapter.take(line.encode() + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")
    assert frame_of(line.encode()) is None


def test_bytes_come_in_any_portions_and_an_endless_line_does_no_harm() -> None:
    adapter = SimulatedAdapter()
    adapter.take(b"O\r")
    assert [adapter.take(bytes((byte,)))[0] for byte in b"t0700\r"] == [[]] * 5 + [[CanFrame(0x70)]]
    assert adapter.take(b"0" * 100_000 + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")


# ---- What simulated servos draw: waiting, holding, moving, and under the torques of a simulated body


OFF: dict[int, float | None] = dict.fromkeys(SERVO_IDS)


def test_a_driven_servo_holds_and_draws_more_until_it_is_there() -> None:
    draw = SimulatedDraw()
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 0) == {**dict.fromkeys(SERVO_IDS, WAITS_MA), 21: 450.0}
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 84 * MS)[21] == 450.0, "30 degrees take 85 ms"
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 86 * MS)[21] == HOLDS_MA
    assert draw.draw_ma({**OFF, 21: 61.0}, (), 100 * MS)[21] == 450.0
    assert draw.draw_ma(OFF, (), 101 * MS)[21] == WAITS_MA < IDLE_MA < HOLDS_MA, "what a stopped one may draw"


def test_a_bodys_torques_decide() -> None:
    torques_nm = [0.0] * 18
    torques_nm[SERVO_IDS.index(22)] = -2.0
    drawn = SimulatedDraw().draw_ma(dict.fromkeys(SERVO_IDS, 90.0) | {63: None}, torques_nm, 0)
    assert drawn == {**dict.fromkeys(SERVO_IDS, 10.0), 22: pytest.approx(2510.0), 63: WAITS_MA}


# ---- The simulated controller of elkapod-2025: its two wires byte by byte, its servos, its battery, its faults


TARGETS = {servo_id: 80.0 + place for place, servo_id in enumerate(SERVO_IDS)}


def frame_to(angles_deg: dict[int, float]) -> bytes:
    """Return a frame with any numbers, legal or not."""
    return struct.pack("<B18f6xB", 0x7E, *angles_deg.values(), 0x0F)


def test_a_start_before_any_frame_waits_for_one_and_is_counted() -> None:
    page, said = ServoPage(), list[str]()
    controller = Elkapod(clock=lambda: 0, on_change=said.append, page=page)
    controller.write(START)
    assert controller.corruptions == {"started before any frame": 1}
    assert set(page.read().values()) == {None}
    controller.exchange(frame_to(TARGETS))
    assert page.read() == TARGETS
    assert said


def test_angles_that_no_servo_has_are_driven_to_its_end_and_counted() -> None:
    controller = Elkapod(clock=lambda: 0)
    controller.exchange(frame_to(TARGETS))
    controller.write(START)
    assert controller.energised == set(SERVO_IDS)
    controller.exchange(frame_to({**TARGETS, 11: -20.0, 12: 1e9, 13: math.inf, 21: math.nan}))
    targets = [controller.servos[servo_id].target_deg for servo_id in (11, 12, 13, 21)]
    assert targets == [0.0, 180.0, 180.0, 83.0]
    assert sum(controller.corruptions.values()) == 4


ALL = CanFrame(0x6A, bytes.fromhex("03ffff"))
NONE = CanFrame(0x6A, bytes(3))
ALL_ON = CanFrame(0x6B, bytes.fromhex("03ffff"))
TOO_MUCH_MA = 4000.0


def outputs(*numbers: int) -> int:
    return sum(1 << number - 1 for number in numbers)


def mask(*numbers: int) -> CanFrame:
    return CanFrame(0x6A, outputs(*numbers).to_bytes(3, "big"))


class Bench:
    """A board and its clock. A frame arrives in the pause behind a pass."""

    def __init__(self) -> None:
        self.now_ns = PASS_NS // 2
        self.board = SimulatedBoard()

    def take(self, frame: CanFrame) -> list[CanFrame]:
        return self.board.take(frame, self.now_ns)

    def ask(self, identifier: int) -> bytes:
        (answer,) = self.take(CanFrame(identifier))
        assert answer.id == identifier + 1
        return answer.data

    def passes(self, number: int) -> list[CanFrame]:
        """Let so many passes go by."""
        sent = []
        for _ in range(number):
            self.now_ns += PASS_NS
            sent += self.board.advance(self.now_ns)
        return sent

    def until(self, answer: int, most: int = 2000) -> tuple[int, CanFrame]:
        """Return after how many passes the first frame with this identifier comes, and the frame."""
        for number in range(1, most + 1):
            for frame in self.passes(1):
                if frame.id == answer:
                    return number, frame
        raise AssertionError(f"no {answer:02X} within {most} passes")

    def measure(self, times: int = 1) -> None:
        self.now_ns += times * MEASURE_NS
        self.said = self.board.advance(self.now_ns)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def fed(bench: Bench) -> Bench:
    """Switch all outputs on, long ago."""
    bench.take(ALL)
    bench.passes(1000)
    assert bench.board.fed == 0x3FFFF
    return bench


# ---- switching


def test_all_eighteen_go_on_one_by_one_in_494_passes(bench: Bench) -> None:
    bench.take(ALL)
    seen = []
    for _ in range(493):
        assert bench.passes(1) == []
        seen.append(bench.board.fed)
    assert [seen.index((1 << number) - 1) + 1 for number in range(1, 19)] == [26 * number for number in range(1, 19)]
    assert bench.passes(1) == [ALL_ON]


@pytest.mark.parametrize(("more", "passes"), [(0, 26 + 230), (9, 26 + 9 * 26 + 230)])
def test_a_mask_within_a_pass_behind_an_answer_waits_230_passes_longer(fed: Bench, more: int, passes: int) -> None:
    """What is to be off is off at once even then."""
    fed.take(NONE)
    fed.until(0x6B)
    wanted = range(1, more + 1)
    fed.take(mask(*wanted))
    assert fed.until(0x6B) == (passes, CanFrame(0x6B, mask(*wanted).data))
    assert {0: 256, 9: 490}[more] == passes


# ---- errors


def test_no_error_is_answered_without_bytes_in_the_next_pass(bench: Bench) -> None:
    assert bench.take(CanFrame(0x64)) == []
    assert bench.passes(5) == [CanFrame(0x65)]
    bench.take(CanFrame(0x96))
    assert bench.passes(5) == [], "there was nothing to delete"


def test_ten_measurements_above_the_limit_block_an_output_and_nine_do_not(fed: Bench) -> None:
    fed.board.draws_ma[4] = TOO_MUCH_MA
    fed.measure(9)
    fed.board.draws_ma[4] = 3900.0
    fed.measure()
    fed.board.draws_ma[4] = TOO_MUCH_MA
    fed.measure(9)
    assert fed.board.fed == 0x3FFFF
    fed.measure()
    assert fed.board.fed == 0x3FFFF & ~outputs(5)
    sent = fed.said + fed.passes(100)
    assert sent == [CanFrame(0x65, bytes.fromhex("02000010")), CanFrame(0x6B, bytes.fromhex("03ffef"))]
    fed.take(ALL)
    assert fed.until(0x6B)[1].data.hex() == "03ffef", "blocked whatever the mask"


def test_each_64_shows_the_next_error_and_96_deletes_the_one_shown_last(bench: Bench) -> None:
    bench.board.fail(8)
    bench.board.fail(2, outputs(1))
    shown = [bench.passes(1)[0].data.hex()]  # the newest unasked
    bench.board.fail(1, 1)
    shown += [bench.passes(1)[0].data.hex()]
    for _ in range(3):
        bench.take(CanFrame(0x64))
        shown.append(bench.passes(1)[0].data.hex())
    assert shown == ["02000001", "0101", "02000001", "08", "0101"]
    for left in ("08", "02000001", ""):  # it goes on behind the place of the one deleted
        bench.take(CanFrame(0x96))
        assert CanFrame(0x97) in bench.passes(1)
        bench.take(CanFrame(0x96))
        bench.take(CanFrame(0x64))
        (answer,) = (frame for frame in bench.passes(1) if frame.id != 0x6B)
        assert answer == CanFrame(0x65, bytes.fromhex(left)), "the second 96 deleted nothing"


@pytest.mark.parametrize(
    ("sensor", "data", "off"), [(0, "0407", range(1, 19)), (1, "0410", ()), (2, "0408", ())], ids=["1", "2", "3"]
)
def test_a_sensor_at_70_degrees_switches_converters_off_and_says_so_every_140_ms_while_that_lasts(
    fed: Bench, sensor: int, data: str, off: Iterable[int]
) -> None:
    fed.board.temperatures_c[sensor] = 69
    fed.measure(20)
    assert fed.said == []
    fed.board.temperatures_c[sensor] = 70
    fed.measure(43)  # 430 ms: at 10, 150, 290 and 430 ms
    errors = [frame.data.hex() for frame in fed.said + fed.passes(1) if frame.id == 0x65]
    assert errors == [data] * 4
    assert fed.board.fed == 0x3FFFF & ~outputs(*off)
    fed.board.temperatures_c[sensor] = 69
    fed.measure(20)
    fed.board.clear_by_hand()
    assert fed.board.fed == 0x3FFFF, "all that the newest mask has, at once"


# ---- its button, its own supply


def test_without_supply_it_forgets_everything_and_is_silent_until_its_button_is_pressed(fed: Bench) -> None:
    fed.board.fail(2, outputs(5))
    fed.board.restart()
    assert fed.board.fed == 0
    assert fed.take(CanFrame(0x70)) == fed.take(ALL) == fed.passes(2000) == []
    fed.board.press_button(fed.now_ns)
    fed.now_ns += 150_000_000
    assert fed.take(CanFrame(0x70)) == []
    fed.now_ns += 20_000_000
    assert fed.take(CanFrame(0x70)) == [CanFrame(0x71, bytes(6))]
    assert fed.passes(1000) == []
    assert fed.board.fed == 0
    fed.take(CanFrame(0x64))
    assert fed.passes(1) == [CanFrame(0x65)]


def test_66_takes_all_supply_after_1000_passes(fed: Bench) -> None:
    assert fed.take(CanFrame(0x66)) == [CanFrame(0x67)]
    fed.passes(999)
    assert fed.board.fed == 0x3FFFF
    fed.passes(2)
    assert fed.board.fed == 0
    assert fed.take(CanFrame(0x70)) == []
