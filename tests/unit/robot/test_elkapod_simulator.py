"""The simulated controller of elkapod-2025: its two wires byte by byte, its servos, its battery, its faults."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.host.servo_page import ServoPage
from gateway.model import elkapod
from gateway.model.elkapod import FRAME_BYTES, SHUTDOWN, START, AnswerError, Measured
from gateway.model.servo import MOVING_A
from gateway.robot.spi.elkapod_simulator import GARBAGE, MOST_HEARTBEATS, SimulatedElkapod
from gateway.robot.spi.simulated_battery import FULL_V, RESISTANCE_OHM, SimulatedBattery
from schemas.robot import SERVO_IDS

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
        self.controller = SimulatedElkapod(
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


def test_frames_alone_drive_nothing(bench: Bench) -> None:
    for _ in range(50):
        bench.exchange()
    assert bench.controller.energised == frozenset()
    assert {servo.angle_deg for servo in bench.controller.servos.values()} == {90.0}
    assert set(bench.page.read().values()) == {None}
    assert bench.said == []


def test_a_start_drives_all_to_the_newest_frame_and_a_shutdown_leaves_all_where_they_are(bench: Bench) -> None:
    bench.started()
    assert bench.targets() == bench.page.read() == TARGETS
    bench.exchange(after_ms=1000)
    assert {servo_id: servo.angle_deg for servo_id, servo in bench.controller.servos.items()} == TARGETS
    bench.controller.uart_write(SHUTDOWN)
    assert bench.controller.energised == frozenset()
    assert set(bench.page.read().values()) == {None}
    bench.exchange(frame_of({11: 10.0}), after_ms=1000)
    assert bench.controller.servos[11].angle_deg == 80.0, "slack: nothing moves it"
    assert bench.said == ["started", "shut down"]
    assert [message for _, message in bench.controller.messages] == [START, SHUTDOWN]
    assert not bench.controller.corruptions


def test_a_servo_without_supply_stays_where_it_is_and_draws_nothing(bench: Bench) -> None:
    bench.started()
    bench.page.feed(ALL - {11})
    bench.exchange(after_ms=1000)
    angles_deg = {servo_id: servo.angle_deg for servo_id, servo in bench.controller.servos.items()}
    assert angles_deg == {**TARGETS, 11: 90.0}
    at_rest_v = bench.measured(frame_of({**TARGETS, 11: 180.0})).voltage_v
    assert bench.measured().voltage_v == pytest.approx(at_rest_v, abs=0.001), "it does not move"
    bench.page.feed(())
    bench.exchange()
    assert sum(bench.measured().feet) == 0, "nothing carries the robot"
    bench.page.feed(ALL)
    assert bench.controller.energised == ALL, "its controller knows of no supply"


def test_a_servo_goes_as_fast_as_its_motor_and_the_last_angles_hold_for_ever(bench: Bench) -> None:
    bench.started()
    bench.exchange(after_ms=1000)
    bench.exchange(frame_of({**TARGETS, 11: 160.0}))
    bench.now_ns += 100 * MS
    assert bench.controller.servos[11].angle_deg == pytest.approx(80 + 35.3, abs=0.1)
    bench.now_ns += 3_600_000 * MS
    assert bench.controller.servos[11].angle_deg == 160.0
    assert bench.controller.energised == ALL
    assert bench.said[-1] == "servo 11 set to 160.00°"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        WORKED_EXAMPLE[:-1],
        WORKED_EXAMPLE + b"\x0f",
        b"\x7f" + WORKED_EXAMPLE[1:],
        WORKED_EXAMPLE[:-1] + b"\x00",
        b"\x00" + WORKED_EXAMPLE[:-1],
        bytes(80),
        b"\xff" * 80,
        bytes.fromhex("06 02 0b 01 5a 00"),
    ],
    ids=["empty", "short", "long", "begin", "end", "shifted", "zeros", "ff", "hexapod-1.0"],
)
def test_what_is_no_frame_changes_nothing_and_as_many_bytes_come_back(bench: Bench, data: bytes) -> None:
    bench.started()
    bench.exchange(frame_of({}))
    before = bench.targets()
    assert len(bench.exchange(data)) == len(data)
    assert bench.targets() == before
    assert bench.measured().voltage_v > 0, "it goes on answering"


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


# ---- the UART


@given(st.lists(st.sampled_from([START, SHUTDOWN, b"\x7e", b"\x7e\x21", b"\x00\xff\x0f", START[:9]])), st.data())
def test_messages_are_found_in_whatever_portions_they_come(parts: list[bytes], data: st.DataObject) -> None:
    """The last whole one counts. (A begin that another message's first bytes complete would be one, too.)"""
    stream = b"".join(parts)
    whole, portioned = Bench(), Bench()
    for each in (whole, portioned):
        each.exchange()
    whole.controller.uart_write(stream)
    while stream:
        length = data.draw(st.integers(1, len(stream)))
        portioned.controller.uart_write(stream[:length])
        stream = stream[length:]
    assert [message for _, message in portioned.controller.messages] == [
        message for _, message in whole.controller.messages
    ]
    complete = [each for each in parts if each in (START, SHUTDOWN)]
    assert len(whole.controller.messages) >= len(complete)
    if complete and parts[-1] == complete[-1]:
        assert whole.controller.energised == (ALL if complete[-1] == START else frozenset())
    assert whole.controller.energised == portioned.controller.energised


def test_a_heartbeat_leaves_every_50_ms(bench: Bench) -> None:
    bench.now_ns += 49 * MS
    assert bench.controller.uart_read() == b""
    bench.now_ns += 1 * MS
    assert bench.controller.uart_read() == bytes.fromhex("7eaa" + "00" * 16 + "ff0f")
    bench.now_ns += 120 * MS
    assert elkapod.Heartbeats().feed(bench.controller.uart_read()) == 2
    bench.now_ns += 30 * MS
    assert elkapod.Heartbeats().feed(bench.controller.uart_read()) == 1
    bench.now_ns += 3_600_000 * MS
    assert elkapod.Heartbeats().feed(bench.controller.uart_read()) == MOST_HEARTBEATS, "the buffer was full"


# ---- what it measures


def test_the_first_answer_is_garbage_and_each_is_of_the_transfer_before(bench: Bench) -> None:
    assert bench.exchange() == GARBAGE
    with pytest.raises(AnswerError):
        elkapod.measured(GARBAGE)
    assert bench.measured().feet == (0,) * 6
    bench.controller.uart_write(START)
    assert bench.measured().feet == (0,) * 6, "of before the start"
    assert bench.measured().feet == pytest.approx((4.38,) * 6, abs=0.01)


def test_without_a_body_it_is_level_and_at_rest_and_no_two_answers_are_the_same(bench: Bench) -> None:
    bench.started()
    answers = [bench.exchange() for _ in range(200)]
    assert len({elkapod.measured(answer).linear_acceleration_m_s2 for answer in answers}) == len(answers)
    for each in map(elkapod.measured, answers):
        assert each.tilt_deg == 0
        assert each.angular_velocity_rad_s == pytest.approx((0, 0, 0), abs=0.02)
        assert each.linear_acceleration_m_s2 == pytest.approx((0, 0, 9.81), abs=0.2)


def test_the_battery_sags_while_servos_move_and_comes_back(bench: Bench) -> None:
    bench.started()
    bench.exchange(after_ms=1000)
    bench.exchange(after_ms=1000)
    rested = bench.measured()
    bench.exchange(frame_of(dict.fromkeys(SERVO_IDS, 180.0)))
    bench.exchange(frame_of(dict.fromkeys(SERVO_IDS, 180.0)))
    moving = bench.measured(frame_of(dict.fromkeys(SERVO_IDS, 180.0)))
    bench.exchange(frame_of(dict.fromkeys(SERVO_IDS, 180.0)), after_ms=1000)
    again = bench.measured(frame_of(dict.fromkeys(SERVO_IDS, 180.0)))
    assert rested.voltage_v - moving.voltage_v == pytest.approx(18 * MOVING_A * RESISTANCE_OHM, abs=0.01)
    assert moving.percent < rested.percent - 10
    assert again.voltage_v == pytest.approx(rested.voltage_v, abs=0.01)


def test_over_an_hour_the_battery_empties_and_it_warms_up(bench: Bench) -> None:
    bench.exchange()
    begun = bench.measured()
    bench.exchange(after_ms=3_600_000)
    later = bench.measured()
    assert later.voltage_v < begun.voltage_v - 0.2
    assert begun.temperature_c == pytest.approx(25, abs=0.1)
    assert 38 < later.temperature_c < 40


def test_an_empty_battery_has_no_percent_and_no_more_charge() -> None:
    battery = SimulatedBattery(charge=0.01)
    battery.draw(1.0, 3600)
    assert battery.charge == 0
    assert battery.percent == 0
    assert SimulatedBattery().voltage_v == pytest.approx(FULL_V - RESISTANCE_OHM)


def test_a_robot_can_be_had_with_a_low_battery() -> None:
    bench = Bench(SimulatedBattery(charge=0.1))
    bench.exchange()
    assert bench.measured().voltage_v == pytest.approx(6.54, abs=0.01)


# ---- faults


def test_switched_off_and_on_it_is_slack_and_has_forgotten_its_angles(bench: Bench) -> None:
    bench.started()
    bench.exchange(after_ms=1000)
    bench.controller.uart_write(START[:5])
    bench.now_ns += 30 * MS
    bench.controller.power_cycle()
    assert bench.controller.energised == frozenset()
    assert set(bench.targets().values()) == set(bench.page.read().values()) == {None}
    bench.now_ns += 49 * MS
    assert bench.controller.uart_read() == b"", "its next heartbeat is 50 ms after power-up"
    bench.controller.uart_write(START[5:])
    assert bench.exchange() == GARBAGE
    assert bench.exchange() != GARBAGE
    assert bench.controller.energised == frozenset(), "half of a start was before, and frames start nothing"


def test_a_silent_one_sends_no_heartbeat_and_answers_all_the_same(bench: Bench) -> None:
    bench.exchange()
    bench.controller.silent = True
    bench.now_ns += 500 * MS
    assert bench.controller.uart_read() == b""
    assert bench.measured().tilt_deg == 0
    bench.controller.silent = False
    assert bench.controller.uart_read() == b"", "those are lost"
    bench.now_ns += 50 * MS
    assert bench.controller.uart_read() != b""


def test_a_frozen_one_answers_the_same_and_obeys_all_the_same(bench: Bench) -> None:
    bench.exchange()
    bench.controller.frozen = True
    assert len({bench.exchange() for _ in range(10)}) == 1
    bench.started()
    bench.controller.frozen = False
    bench.exchange()
    assert bench.measured().feet != (0,) * 6


def test_one_with_garbage_answers_garbage_until_it_does_not(bench: Bench) -> None:
    bench.exchange()
    bench.controller.garbage = b"\xff" * FRAME_BYTES
    bench.exchange()
    assert bench.exchange() == b"\xff" * FRAME_BYTES
    bench.controller.garbage = None
    bench.exchange()
    assert bench.measured().tilt_deg == 0
