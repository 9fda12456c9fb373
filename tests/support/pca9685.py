"""An emulated I2C bus with PCA9685 boards, in place of `smbus2`, by the data sheet (NXP, Rev. 4, chapter 7.3)."""

import errno
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Final
from unittest.mock import patch

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
        """The pulse at an output; None: it is low."""
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


@contextmanager
def in_place_of_smbus2(bus: I2cBus) -> Iterator[None]:
    """Serve the example's `from smbus2 import SMBus`."""
    module = ModuleType("smbus2")
    module.SMBus = bus.smbus  # type: ignore[attr-defined]
    with patch.dict(sys.modules, {"smbus2": module}):
        yield
