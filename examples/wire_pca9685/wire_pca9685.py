"""Servos on PCA9685 boards on I2C, as a wire of hexapod-gateway (docs/protocol.md, Bring your own wire).

    [wire]
    name = "pca9685"
    bus = 1                       # /dev/i2c-1
    pulse_us = [500, 2500]        # at 0 and 180 degrees, of every servo that names none of its own
    [wire.servos]                 # each servo's board and channel, or [board, channel, pulse at 0, pulse at 180]
    11 = [0x40, 0]

Registers and their meaning: NXP, PCA9685, product data sheet, Rev. 4, chapter 7.3.
"""

import errno
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from smbus2 import SMBus

from gateway.wire import ServoWire

MODE1, MODE2, LED0, ALL_LED, PRESCALE = 0x00, 0x01, 0x06, 0xFA, 0xFE
SLEEP, AUTO_INCREMENT, TOTEM_POLE = 0x10, 0x20, 0x04
FULL_OFF = (0, 0, 0, 0x10)
"""ON and OFF, low byte first: bit 4 of the last byte holds the output low, so the servo gets no pulse."""
OSCILLATOR_HZ, COUNTS = 25_000_000, 4096
MOST_BYTES = 32
"""Of a block on the bus: eight channels."""
WAKES_S = 0.0005
"""The oscillator needs this time after a sleep."""
SHORTEST_US, LONGEST_US = 300, 2700
"""No hobby servo takes a pulse beyond; one at its stop burns."""


class Output(NamedTuple):
    """Where a servo is, and its pulses."""

    board: int
    channel: int
    at_0_us: float
    at_180_us: float


class Pca9685(ServoWire):
    """Boards are set up when they are opened, which switches all outputs off; a Stop is full-off."""

    def __init__(self, options: Mapping[str, object]) -> None:
        known = {"bus", "frequency_hz", "pulse_us", "servos"}
        if unknown := options.keys() - known:
            raise ValueError(
                f"{', '.join(sorted(unknown))} is no option of pca9685; there are {', '.join(sorted(known))}"
            )
        self._bus_number = _whole(options, "bus", 1, 0, 255)
        frequency_hz = _whole(options, "frequency_hz", 50, 40, 330)
        self._prescale = round(OSCILLATOR_HZ / (COUNTS * frequency_hz)) - 1
        self._count_us = (self._prescale + 1) * 1e6 / OSCILLATOR_HZ
        self._outputs = _outputs(options)
        self._boards = sorted({each.board for each in self._outputs.values()})
        self._open_bus: SMBus | None = None

    @property
    def _bus(self) -> SMBus:
        if self._open_bus is None:
            raise OSError(errno.EBADF, "it is not open")
        return self._open_bus

    def open(self) -> None:
        self.close()
        self._open_bus = SMBus(self._bus_number)
        for board in self._boards:
            self._bus.write_byte_data(board, MODE1, SLEEP | AUTO_INCREMENT)  # the prescaler is written in sleep only
            self._bus.write_i2c_block_data(board, ALL_LED, FULL_OFF)
            self._bus.write_byte_data(board, PRESCALE, self._prescale)
            self._bus.write_byte_data(board, MODE2, TOTEM_POLE)
            self._bus.write_byte_data(board, MODE1, AUTO_INCREMENT)
        time.sleep(WAKES_S)
        for board in self._boards:
            self._check(board, PRESCALE, (self._prescale,))

    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        wanted: dict[int, dict[int, tuple[int, ...]]] = {}
        for servo, angle_deg in changes:
            output = self._outputs[servo]
            wanted.setdefault(output.board, {})[output.channel] = self._counts(output, angle_deg)
        for board, channels in wanted.items():
            for channel, data in _runs(channels):
                self._bus.write_i2c_block_data(board, LED0 + 4 * channel, data)
                self._check(board, LED0 + 4 * channel, data)

    def close(self) -> None:
        bus, self._open_bus = self._open_bus, None
        if bus is not None:
            with suppress(OSError):
                bus.close()

    def _counts(self, output: Output, angle_deg: float | None) -> tuple[int, ...]:
        """The four bytes of an output."""
        if angle_deg is None:
            return FULL_OFF
        pulse_us = output.at_0_us + (output.at_180_us - output.at_0_us) * angle_deg / 180
        counts = round(pulse_us / self._count_us)
        return 0, 0, counts & 0xFF, counts >> 8

    def _check(self, board: int, register: int, data: Sequence[int]) -> None:
        """Read back what was written, and whether the board is awake: one that lost its supply has forgotten all."""
        if self._bus.read_byte_data(board, MODE1) & SLEEP:
            raise OSError(errno.EIO, f"board 0x{board:02x} was reset")
        if tuple(self._bus.read_i2c_block_data(board, register, len(data))) != tuple(data):
            raise OSError(errno.EIO, f"board 0x{board:02x} has not taken what was written")


def _runs(channels: Mapping[int, tuple[int, ...]]) -> Iterator[tuple[int, list[int]]]:
    """Neighbouring channels together: the first of them, and the bytes of all; no more than a block has."""
    first, data = 0, list[int]()
    for channel in sorted(channels):
        if data and (channel != first + len(data) // 4 or len(data) == MOST_BYTES):
            yield first, data
            data = []
        first = first if data else channel
        data = [*data, *channels[channel]]
    yield first, data


def _outputs(options: Mapping[str, object]) -> dict[int, Output]:
    stated, usual = options.get("servos"), _numbers(options.get("pulse_us", [500, 2500]), "pulse_us", (2,))
    wanted = {10 * leg + joint for leg in range(1, 7) for joint in range(1, 4)}
    if not isinstance(stated, Mapping) or {str(servo) for servo in wanted} != set(stated):
        raise ValueError("servos names all 18, 11 to 63, such as 11 = [0x40, 0]: board and channel")
    found = {}
    for servo in sorted(wanted):
        board, channel, *pulses = _numbers(stated[str(servo)], f"servos.{servo}", (2, 4))
        if not (0x40 <= board <= 0x7F and 0 <= channel <= 15):
            raise ValueError(f"servos.{servo}: a board is 0x40 to 0x7f, a channel 0 to 15")
        at_0_us, at_180_us = pulses or usual
        if not all(SHORTEST_US <= pulse <= LONGEST_US for pulse in (at_0_us, at_180_us)):
            raise ValueError(f"servos.{servo}: pulses are {SHORTEST_US} to {LONGEST_US} µs")
        found[servo] = Output(int(board), int(channel), at_0_us, at_180_us)
    if len({each[:2] for each in found.values()}) != len(found):
        raise ValueError("two servos are on one channel")
    return found


def _numbers(value: object, name: str, counts: tuple[int, ...]) -> list[float]:
    right = isinstance(value, list) and len(value) in counts
    if not right or not all(isinstance(each, int | float) for each in value):  # type: ignore[attr-defined]
        raise ValueError(f"{name}: write {' or '.join(map(str, counts))} numbers in brackets")
    return list(value)  # type: ignore[call-overload, no-any-return]


def _whole(options: Mapping[str, object], name: str, default: int, low: int, high: int) -> int:
    value = options.get(name, default)
    if not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name}: write a whole number from {low} to {high}")
    return value
