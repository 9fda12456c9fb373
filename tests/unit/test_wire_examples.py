"""Examples of plug-ins: PCA9685 boards on an emulated bus, Freenove's kit behind it, and a Pololu Maestro."""

import errno
import math
import os
import pty
import runpy
import sys
import threading
import tomllib
import tty
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import pytest

from gateway.errors import SpiError
from gateway.geometry import load
from gateway.host import settings_table
from gateway.host.settings_table import WireSettings
from gateway.model.frames import OneLeg, Op, ServoOp, stop_leg
from gateway.onboard.check import conformance
from gateway.people.walking.robot import Robot, ranges
from gateway.robot.spi.plugin import plugin_bus
from gateway.wire import ServoWire
from schemas.config import LimitsReport
from schemas.robot import LEGS
from tests.support.waiting import Closing

_MODE1, _LED0, _ALL_LED, _PRESCALE = 0x00, 0x06, 0xFA, 0xFE
_SLEEP, _AUTO_INCREMENT, _RESTART = 0x10, 0x20, 0x80
_FULL: Final = 0x10
_OSCILLATOR_HZ: Final = 25_000_000


class Board:
    """The registers of one chip."""

    def __init__(self) -> None:
        self.plugged = True
        self.reset()

    def reset(self) -> None:
        """Power the board up: asleep, all outputs full-off, 200 Hz."""
        self._registers = bytearray(256)
        self._registers[_MODE1] = _SLEEP | 0x01
        self._registers[_PRESCALE] = 0x1E
        for channel in range(16):
            self._registers[_LED0 + 4 * channel + 3] = _FULL

    def write(self, register: int, data: Sequence[int]) -> None:
        for value in data:
            if register == _PRESCALE and not self._registers[_MODE1] & _SLEEP:
                pass  # "can only be set when the SLEEP bit of MODE1 register is set to logic 1"
            elif _ALL_LED <= register < _PRESCALE:
                for channel in range(16):
                    self._registers[_LED0 + 4 * channel + register - _ALL_LED] = value
            else:
                self._registers[register] = value & (0xFF ^ _RESTART) if register == _MODE1 else value
            register += 1 if self._registers[_MODE1] & _AUTO_INCREMENT else 0

    def read(self, register: int, count: int) -> list[int]:
        step = 1 if self._registers[_MODE1] & _AUTO_INCREMENT else 0
        return [self._registers[register + step * place] for place in range(count)]

    def pulse_us(self, channel: int) -> float | None:
        """Return the pulse at an output; None: it is low."""
        on_low, on_high, off_low, off_high = self._registers[_LED0 + 4 * channel :][:4]
        if off_high & _FULL or self._registers[_MODE1] & _SLEEP:
            return None
        counts = (off_low | off_high << 8) - (on_low | on_high << 8)
        return counts * (self._registers[_PRESCALE] + 1) * 1e6 / _OSCILLATOR_HZ


class I2cBus:
    """Stands for `smbus2.SMBus`, with these boards on it."""

    def __init__(self, *addresses: int) -> None:
        self.boards = {address: Board() for address in addresses}
        self.is_open = 0

    def smbus(self, _number: int) -> "I2cBus":
        """Open the bus, as `smbus2.SMBus` does."""
        self.is_open += 1
        return self

    def close(self) -> None:
        self.is_open -= 1

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int]) -> None:
        self._board(address).write(register, data)

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self._board(address).write(register, (value,))

    def read_i2c_block_data(self, address: int, register: int, count: int) -> list[int]:
        return self._board(address).read(register, count)

    def read_byte_data(self, address: int, register: int) -> int:
        return self._board(address).read(register, 1)[0]

    def _board(self, address: int) -> Board:
        board = self.boards.get(address)
        if board is None or not board.plugged:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")  # nobody acknowledges the address
        return board


EXAMPLES = Path(__file__).parents[2] / "examples"
KIT = EXAMPLES / "freenove"
OPTIONS: dict[str, Any] = tomllib.loads((KIT / "gateway.toml").read_text())["wire"]
assert OPTIONS.pop("name") == "pca9685"
LEFT, RIGHT = 0x40, 0x41
MAESTRO: dict[str, object] = {"path": "/dev/ttyACM0"}


@pytest.fixture
def bus() -> I2cBus:
    return I2cBus(LEFT, RIGHT)


def example(name: str, kind: str) -> Any:
    """Return an example's class of a wire."""
    return runpy.run_path(str(EXAMPLES / name / f"{name}.py"))[kind]


@pytest.fixture
def kind(bus: I2cBus, monkeypatch: pytest.MonkeyPatch) -> type[ServoWire]:
    smbus2: Any = SimpleNamespace(SMBus=bus.smbus)
    monkeypatch.setitem(sys.modules, "smbus2", smbus2)
    found: type[ServoWire] = example("wire_pca9685", "Pca9685")
    return found


@pytest.fixture
def wire(kind: type[ServoWire], monkeypatch: pytest.MonkeyPatch) -> WireSettings:
    monkeypatch.setattr(settings_table, "load_plugin", lambda _name, options: kind(options))
    return WireSettings("pca9685", OPTIONS)


def pulses(bus: I2cBus) -> dict[int, float | None]:
    """Return what each servo gets, in µs."""
    places = {int(servo): place for servo, place in OPTIONS["servos"].items()}
    return {servo: bus.boards[board].pulse_us(channel) for servo, (board, channel) in places.items()}


def leg(number: int, op: Op, *angles_deg: float) -> OneLeg:
    first, second, third = (ServoOp(op, round(100 * angle_deg)) for angle_deg in angles_deg)
    return OneLeg(number, (first, second, third))


def test_angles_are_pulses_and_stops_are_full_off(bus: I2cBus, wire: WireSettings) -> None:
    plugin = plugin_bus(wire)
    plugin.open()
    assert set(pulses(bus).values()) == {None}
    plugin.write([leg(number, Op.START, 0, 90, 180) for number in LEGS])
    for servo, pulse_us in pulses(bus).items():
        assert pulse_us == pytest.approx({1: 500, 2: 1500, 3: 2500}[servo % 10], abs=3)
    plugin.write([stop_leg(3)])
    assert {servo for servo, pulse_us in pulses(bus).items() if pulse_us is None} == {31, 32, 33}
    plugin.write([stop_leg(number) for number in LEGS])
    assert set(pulses(bus).values()) == {None}
    plugin.close()
    assert bus.is_open == 0


@pytest.mark.parametrize("absent", [LEFT, RIGHT])
def test_an_absent_board_is_a_fault_and_the_other_ones_servos_are_stopped(
    bus: I2cBus, wire: WireSettings, absent: int
) -> None:
    plugin = plugin_bus(wire)
    plugin.open()
    plugin.write([leg(number, Op.START, 90, 90, 90) for number in LEGS])
    bus.boards[absent].plugged = False
    report = plugin.write([stop_leg(number) for number in LEGS])
    assert "Remote I/O error" in str(report.fault)
    stopped = {servo for servo, pulse_us in pulses(bus).items() if pulse_us is None}
    assert stopped == {int(servo) for servo, (board, _) in OPTIONS["servos"].items() if board != absent}
    plugin.release()
    with pytest.raises(SpiError, match="Remote I/O error"):
        plugin.open()


def test_a_board_that_lost_its_supply_is_a_fault(bus: I2cBus, wire: WireSettings) -> None:
    plugin = plugin_bus(wire)
    plugin.open()
    bus.boards[RIGHT].reset()
    report = plugin.write([leg(2, Op.START, 90, 90, 90)])
    assert "board 0x41 was reset" in str(report.fault)


def check_contract(file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(conformance, "_HOLD_S", 0)
    monkeypatch.setattr(conformance, "_LATE_MS", 10_000.0)  # this machine's load is not the wire's
    assert conformance.conformance(file, agreed=True, unplug=False) == 0, capsys.readouterr().out


@pytest.mark.usefixtures("wire")
def test_the_pca9685_keeps_the_contract_of_a_wire(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    check_contract(KIT / "gateway.toml", monkeypatch, capsys)


# ---- the kit


def kits_own_deg(leg: int, outward_mm: float, tangential_mm: float, up_mm: float) -> tuple[float, float, float]:
    """Return the servos' angles by the formulas of the kit's own software, which rounds them to whole degrees."""
    coxa_mm, femur_mm, tibia_mm = 33, 90, 110
    hip = math.pi / 2 - math.atan2(tangential_mm, outward_mm)
    out_mm = outward_mm - coxa_mm * math.sin(hip)
    aside_mm = tangential_mm - coxa_mm * math.cos(hip)
    reach_mm = math.hypot(up_mm, out_mm, aside_mm)
    lift = math.acos((femur_mm**2 + reach_mm**2 - tibia_mm**2) / (2 * femur_mm * reach_mm))
    knee = math.pi - math.acos((femur_mm**2 + tibia_mm**2 - reach_mm**2) / (2 * femur_mm * tibia_mm))
    a, b, c = math.degrees(hip), math.degrees(math.asin(-up_mm / reach_mm) - lift), math.degrees(knee)
    return (a, 90 + b, 180 - c) if leg % 2 else (a, 90 - b, c)


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("foot_mm", [(140, 0, -39), (120, 30, -60), (150, -25, -20)])
def test_the_geometry_sends_what_the_kits_own_software_would(leg: int, foot_mm: tuple[float, float, float]) -> None:
    geometry = load(KIT / "geometry.json")
    mount, (outward_m, tangential_m, up_m) = geometry.leg_mounts[leg], (each / 1000 for each in foot_mm)
    cos, sin = math.cos(mount.yaw_rad), math.sin(mount.yaw_rad)
    x_m, y_m, z_m = mount.xyz_m
    foot_m = x_m + cos * outward_m - sin * tangential_m, y_m + sin * outward_m + cos * tangential_m, z_m + up_m
    found = Robot(geometry, ranges(LimitsReport(), None)).angles_deg(leg, foot_m)
    assert found == pytest.approx(kits_own_deg(leg, *foot_mm), abs=0.1)


# ---- the Maestro


class Maestro(Closing):
    """Takes Set Target and Get Errors of the compact protocol, as the user's guide has them (chapter 5.e)."""

    def __init__(self) -> None:
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        self.path = os.ttyname(self._theirs)
        self.targets: dict[int, int] = {}
        self.errors = b"\0\0"
        threading.Thread(target=self._run, daemon=True).start()

    def close(self) -> None:
        os.close(self._theirs)

    def _run(self) -> None:
        with suppress(OSError), open(self._ours, "r+b", buffering=0) as port:  # closed
            while command := port.read(1):
                if command == b"\xa1":
                    port.write(self.errors)
                else:
                    assert command == b"\x84", command
                    channel, low, high = (port.read(1)[0] for _ in range(3))
                    self.targets[channel] = low | high << 7


@pytest.fixture
def board() -> Iterator[Maestro]:
    with Maestro() as running:
        yield running


@pytest.fixture
def maestro_kind() -> Any:
    return example("wire_maestro", "Maestro")


def test_angles_are_quarters_of_a_microsecond_and_a_stop_is_0(board: Maestro, maestro_kind: type[ServoWire]) -> None:
    wire = maestro_kind({"path": board.path, "channels": [*range(17), 23]})
    wire.open()
    with closing(wire):
        wire.apply([(11, 0.0), (12, 90.0), (63, 180.0)])
        assert board.targets == {0: 2000, 1: 6000, 23: 10_000}
        wire.apply([(12, None)])
        assert board.targets == {0: 2000, 1: 0, 23: 10_000}


def test_the_bytes_are_those_of_the_users_guides_example(maestro_kind: type[ServoWire]) -> None:
    """Chapter 5.e: 1500 µs on channel 2 is 0x84, 0x02, 0x70, 0x2E, and a target of 0 ends the pulses."""
    wire: Any = maestro_kind({"path": "/dev/null"})
    assert wire._target(13, 90.0) == bytes([0x84, 0x02, 0x70, 0x2E])
    assert wire._target(13, None) == bytes([0x84, 0x02, 0x00, 0x00])


@pytest.mark.parametrize(("errors", "sentence"), [(b"\x10\0", "the Maestro reports 1000"), (b"", "does not answer")])
def test_an_error_and_no_answer_are_faults(
    board: Maestro, maestro_kind: type[ServoWire], errors: bytes, sentence: str
) -> None:
    board.errors = errors
    wire = maestro_kind({"path": board.path})
    wire.open()
    with closing(wire), pytest.raises(OSError, match=sentence):
        wire.apply([(11, None)])


def test_the_maestro_keeps_the_contract_of_a_wire(
    board: Maestro,
    maestro_kind: type[ServoWire],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(settings_table, "load_plugin", lambda _name, options: maestro_kind(options))
    file = tmp_path / "gateway.toml"
    file.write_text(f'[wire]\nname = "maestro"\npath = "{board.path}"')
    check_contract(file, monkeypatch, capsys)


@pytest.mark.parametrize(
    ("given", "change", "sentence"),
    [
        (OPTIONS, {"speed": 1}, "speed is no option of pca9685"),
        (OPTIONS, {"pulse_us": [500, 3000]}, "pulses are 300 to 2700"),
        (OPTIONS, {"servos": {**OPTIONS["servos"], "11": [0x20, 0]}}, r"servos\.11: a board is 0x40"),
        (OPTIONS, {"servos": {**OPTIONS["servos"], "11": OPTIONS["servos"]["12"]}}, "two servos are on one channel"),
        (MAESTRO, {"speed": 1}, "speed is not an option"),
        (MAESTRO, {"path": 5}, "path: write the port"),
        (MAESTRO, {"channels": [0] * 18}, "18 different whole numbers"),
        (MAESTRO, {"pulse_us": [500, 3000]}, "300 to 2700"),
    ],
)
def test_wrong_options_are_a_sentence(
    kind: Any, maestro_kind: Any, given: dict[str, object], change: dict[str, object], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        (maestro_kind if given is MAESTRO else kind)({**given, **change})
