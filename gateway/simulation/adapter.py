"""A simulated CAN adapter that speaks slcan on a serial line. Pure.

| line          | answer        | does                                                    |
|---------------|---------------|---------------------------------------------------------|
| S0-S8, sXXXX  | `\\r`          | sets the bit rate, while the channel is closed           |
| O             | `\\r`          | opens the channel                                        |
| C             | `\\r`          | closes it                                                |
| tIIILDD…      | `\\r`          | puts a frame on the bus                                  |
| r, T, R       | `\\r`          | frames of other kinds, which the power board does not take |
| nothing       | `\\r`          |                                                         |
| anything else | `\\a`          | as what is not allowed now                               |

While the channel is open, each frame on the bus leaves as `tIIILDD…\\r`.
"""

from typing import Final

from gateway.model.power_board import CanFrame

OK: Final = b"\r"
ERROR: Final = b"\a"
_LONGEST: Final = 32
"""Bytes of a line; T with 8 bytes of data has 26."""


class SimulatedAdapter:
    """The adapter; its channel is closed at first."""

    def __init__(self) -> None:
        self._open = False
        self._line = bytearray()

    def take(self, data: bytes) -> tuple[list[CanFrame], bytes]:
        """Bytes of its client arrive: the frames for the bus, and what it answers."""
        frames: list[CanFrame] = []
        answers = bytearray()
        for byte in data:
            if byte == OK[0]:
                answers += self._obey(bytes(self._line), frames)
                self._line.clear()
            elif len(self._line) < _LONGEST:
                self._line.append(byte)
        return frames, bytes(answers)

    def text(self, frame: CanFrame) -> bytes:
        """What its client gets of a frame on the bus; nothing while the channel is closed."""
        return text_of(frame) if self._open else b""

    def _obey(self, line: bytes, frames: list[CanFrame]) -> bytes:
        command = line[:1]
        if command == b"C" or (command == b"O" and not self._open):
            self._open = command == b"O"
        elif command == b"t" and self._open and (frame := frame_of(line)):
            frames.append(frame)
        elif command not in ((b"T", b"r", b"R") if self._open else (b"S", b"s")) and line:
            return ERROR
        return OK


def text_of(frame: CanFrame) -> bytes:
    """`tIIILDD…` and a carriage return."""
    return b"t%03X%d%s\r" % (frame.id, len(frame.data), frame.data.hex().upper().encode())


def frame_of(line: bytes) -> CanFrame | None:
    """The frame of `tIIILDD…`; None where the line is none."""
    try:
        identifier, length, data = int(line[1:4], 16), int(line[4:5]), bytes.fromhex(line[5:].decode("ascii"))
    except ValueError:
        return None
    if not (line[:1] == b"t" and 0 <= identifier <= 0x7FF and len(data) == length <= 8 and len(line) == 5 + 2 * length):
        return None
    return CanFrame(identifier, data)
