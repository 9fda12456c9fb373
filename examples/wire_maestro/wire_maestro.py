"""Servos on a Pololu Mini Maestro 18 or 24, on USB or a serial port, as a wire of hexapod-gateway.

    [wire]
    name = "maestro"
    path = "/dev/ttyACM0"
    pulse_us = [500, 2500]      # at 0 and 180 degrees; within the Maestro's own limits for each channel
    channels = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17]    # of servos 11, 12, 13, 21, … 63

Bytes: Pololu Maestro Servo Controller User's Guide, chapter 5.e (Set Target, Get Errors), compact protocol.
"""

import errno
from collections.abc import Mapping, Sequence

import serial

from gateway.wire import ServoWire

SERVOS = [10 * leg + joint for leg in range(1, 7) for joint in range(1, 4)]
SET_TARGET, GET_ERRORS = 0x84, 0xA1
ANSWER_S = 0.05
"""USB answers within 1 ms."""


class Maestro(ServoWire):
    """A Stop is target 0: no pulse. Each call ends with a question, whose answer shows that the board is there."""

    def __init__(self, options: Mapping[str, object]) -> None:
        path, pulse_us = options.get("path"), options.get("pulse_us", [500, 2500])
        channels = options.get("channels", list(range(18)))
        if unknown := options.keys() - {"path", "pulse_us", "channels"}:
            raise ValueError(f"{', '.join(sorted(unknown))} is not an option of maestro")
        if not isinstance(path, str):
            raise ValueError('path: write the port, such as path = "/dev/ttyACM0"')
        if not isinstance(channels, list) or len({*channels}) != 18 or not {*channels} <= {*range(24)}:
            raise ValueError("channels: write 18 different whole numbers, 0 to 23")
        if not isinstance(pulse_us, list) or len(pulse_us) != 2 or not all(300 <= each <= 2700 for each in pulse_us):
            raise ValueError("pulse_us: write two numbers, 300 to 2700")
        self._path, self._pulse_us = path, pulse_us
        self._channels = dict(zip(SERVOS, channels, strict=True))
        self._port: serial.Serial | None = None

    def open(self) -> None:
        self.close()
        self._port = serial.Serial(self._path, timeout=ANSWER_S, write_timeout=ANSWER_S)

    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        if self._port is None:
            raise OSError(errno.EBADF, "it is not open")
        self._port.reset_input_buffer()
        self._port.write(b"".join(self._target(*change) for change in changes) + bytes([GET_ERRORS]))
        answer = self._port.read(2)
        if len(answer) < 2 or any(answer):
            raise OSError(errno.EIO, f"the Maestro reports {answer.hex()}" if answer else "the Maestro does not answer")

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _target(self, servo: int, angle_deg: float | None) -> bytes:
        at_0_us, at_180_us = self._pulse_us
        quarters = 0 if angle_deg is None else round(4 * (at_0_us + (at_180_us - at_0_us) * angle_deg / 180))
        return bytes([SET_TARGET, self._channels[servo], quarters & 0x7F, quarters >> 7])
