"""The bytes of `elkapod-2025`: eighteen angles out, what the robot measures back, and the messages of its UART. Pure.

| bytes to the controller | content                                                                              |
|-------------------------|--------------------------------------------------------------------------------------|
| 0                       | 7E                                                                                   |
| 1-72                    | eighteen servo angles in degrees, float32, little endian: legs 1 to 6, joints 1 to 3 |
| 73-78                   | zeros                                                                                |
| 79                      | 0F                                                                                   |

An answer has as many bytes, with the same first and last byte (`_ANSWER`). Neither has a length, a type or a checksum,
so an answer is checked only as far as possible (`measured`). No frame has a Stop: UART messages start and shut down all
servos. The values' units are undocumented; docs/protocol.md states the assumed ones.
"""

import math
import re
import struct
from collections.abc import Sequence
from itertools import chain
from typing import Final, NamedTuple

from gateway.model.frames import MAX_ANGLE_CDEG
from schemas.robot import SERVO_IDS

FRAME_BYTES: Final = 80
BEGIN: Final = 0x7E
END: Final = 0x0F
MIDDLE_CDEG: Final = 90_00
"""The angle in a frame for a servo that was never commanded, while all are shut down."""
VALUES: Final = slice(1, 77)
"""The bytes of an answer's nineteen values."""
_FRAME: Final = struct.Struct("<B18f6xB")
_ANSWER: Final = struct.Struct("<B19f2xB")

UART_BAUD: Final = 1_152_000
"""8 bits, no parity, two stop bits, no flow control."""
START: Final = bytes.fromhex("7E 21 87 00 00 00 00 00 FF 0F")
SHUTDOWN: Final = bytes.fromhex("7E 11 38 00 00 00 00 00 FF 0F")
"""Messages to the controller, which acknowledges neither."""
HEARTBEAT_BYTES: Final = 20
_HEARTBEAT: Final = re.compile(rb"\x7e\xaa.{16}\xff\x0f", re.DOTALL)


class AnswerError(ValueError):
    """The bytes are no answer, for the reason in the text."""


class Measured(NamedTuple):
    """The measurements in an answer."""

    temperature_c: float
    voltage_v: float
    percent: float
    orientation_wxyz: tuple[float, float, float, float]
    angular_velocity_rad_s: tuple[float, float, float]
    linear_acceleration_m_s2: tuple[float, float, float]
    feet: tuple[float, float, float, float, float, float]
    """Forces of legs 1 to 6, in an undocumented unit."""

    @property
    def tilt_deg(self) -> float | None:  # mutants accepted (LtE_Lt): either answer is as good
        """The angle between the body's up and the world's, 0 to 180; None if the orientation is invalid."""
        w, x, y, z = self.orientation_wxyz
        norm = w * w + x * x + y * y + z * z
        # A quaternion that is far from its length of 1 is no orientation: all zeros before the sensor is ready.
        if not 0.81 <= norm <= 1.21:
            return None
        # Rounding is monotonic, so x² + y² is never more than the norm, and this never beyond -1 or 1.
        return math.degrees(math.acos(1 - 2 * (x * x + y * y) / norm))


def frame(angles_cdeg: Sequence[int]) -> bytes:
    """Return the frame with these wire angles of servos 11 to 63, in hundredths of a degree.

    Raises ValueError unless there are eighteen of 0 to 18000: the controller does not check them.
    """
    for servo_id, angle_cdeg in zip(SERVO_IDS, angles_cdeg, strict=True):
        if not 0 <= angle_cdeg <= MAX_ANGLE_CDEG:
            raise ValueError(
                f"servo {servo_id} at {angle_cdeg} hundredths of a degree; 0 to {MAX_ANGLE_CDEG} are legal"
            )
    return _FRAME.pack(BEGIN, *(angle_cdeg / 100 for angle_cdeg in angles_cdeg), END)


def measured(data: bytes) -> Measured:
    """Read an answer. Raises AnswerError if its length, first or last byte is wrong, or a value is not finite."""
    if len(data) != FRAME_BYTES:
        raise AnswerError(f"it has {len(data)} bytes in place of {FRAME_BYTES}")
    if data[0] != BEGIN or data[-1] != END:
        raise AnswerError(f"it goes from {data[0]:02x} to {data[-1]:02x} in place of 7e to 0f")
    _, *values, _ = _ANSWER.unpack(data)
    if not all(map(math.isfinite, values)):
        raise AnswerError("it has a value that is not finite")
    temperature_c, voltage_v, percent, w, x, y, z, p, q, r, a, b, c, *feet = values
    one, two, three, four, five, six = feet
    return Measured(
        temperature_c, voltage_v, percent, (w, x, y, z), (p, q, r), (a, b, c), (one, two, three, four, five, six)
    )


def answer(values: Measured) -> bytes:
    """Return the bytes of an answer, as a controller sends it: for simulated controllers."""
    return _ANSWER.pack(BEGIN, *values[:3], *chain.from_iterable(values[3:]), END)


def heartbeat(content: bytes = bytes(16)) -> bytes:
    """Return a heartbeat with this content (16 bytes, meaning unknown): for simulated controllers."""
    return bytes((BEGIN, 0xAA, *content, 0xFF, END))


def heartbeats(data: bytes) -> tuple[int, bytes]:
    """Return how many heartbeats are in these bytes, and the last bytes, in which another one may begin."""
    found = list(_HEARTBEAT.finditer(data))
    rest = data[found[-1].end() :] if found else data
    return len(found), rest[1 - HEARTBEAT_BYTES :]
