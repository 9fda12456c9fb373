"""The frames of HexapodProtocol v1.0.0, as values and as bytes, and the framings.

| frame     | byte 1, FRAME LEN | byte 2, FRAME TYPE | the rest                                   |
|-----------|-------------------|--------------------|--------------------------------------------|
| ONE LEG   | 14                | 1                  | three times SERVO ID, OP, INT, FLOAT       |
| ONE SERVO | 6                 | 2                  | once        SERVO ID, OP, INT, FLOAT       |

A servo id is leg (1 to 6) times ten plus joint (1 to 3, from the body outward). INT is whole degrees, FLOAT hundredths
of a degree, together 0.00° to 180.00°. A Stop has neither: any values are read, and 0 0 is written.

The controller checks nothing and corrupts its own memory on a bad id, so no illegal frame can be built here. Messages
count bytes from 1, as docs/protocol.md does.
"""

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from schemas.robot import JOINTS, LEGS, SERVO_IDS

PROTOCOL_VERSION: Final = "1.0.0"
STOP_REPEATS: Final = 3
"""Repeats of a Stop, each after a preamble, since the wire acknowledges nothing. Longer faults meet the further runs of
Stops while nothing runs (docs/protocol.md)."""
STOP_REPEAT_MS: Final = 20.0
"""Time between repeats: one period of the servos' PWM, and one frame on a wire with cycles."""
MAX_ANGLE_CDEG: Final = 180_00

_SERVO_ID_SET: Final = frozenset(SERVO_IDS)
ONE_LEG_LEN: Final = 14
ONE_LEG_TYPE: Final = 1
ONE_SERVO_LEN: Final = 6
ONE_SERVO_TYPE: Final = 2
_ONE_LEG: Final = bytes((ONE_LEG_LEN, ONE_LEG_TYPE))
_ONE_SERVO: Final = bytes((ONE_SERVO_LEN, ONE_SERVO_TYPE))
_IDS: Final = {servo_id: bytes((servo_id,)) for servo_id in SERVO_IDS}
_IDS_OF_LEG: Final = {
    leg: ((one, two, three), _ONE_LEG + _IDS[one], _IDS[two], _IDS[three])
    for leg, one, two, three in ((leg, *(10 * leg + joint for joint in JOINTS)) for leg in LEGS)
}
"""Of each leg: its servos, and the bytes of a frame that precede each operation."""


class FrameError(ValueError):
    """Not a frame of the protocol; the message names the byte (counted from 1) or field, and what would be legal."""


class Op(enum.IntEnum):
    """SERVO OP TYPE: START energises the servo and sets its angle, STOP de-energises it, SET moves it."""

    START = 1
    STOP = 2
    SET = 3


OP_START: Final = Op.START
OP_STOP: Final = Op.STOP
OP_SET: Final = Op.SET
"""Shortcuts for each setpoint: in Python 3.11 an enum's attribute takes as long as three calls."""


@dataclass(slots=True, init=False, unsafe_hash=True)
class ServoOp:  # mutants accepted (FalseWithTrue, LeaveOut): it follows from the other fields
    """One servo's operation and angle, in hundredths of a degree, 0 to 18000 (0 for STOP)."""

    op: Final[Op]
    angle_cdeg: Final[int]
    data: bytes = field(compare=False, repr=False)
    """OP, INT and FLOAT."""

    def __init__(self, op: Op, angle_cdeg: int = 0) -> None:
        if not 0 <= angle_cdeg <= MAX_ANGLE_CDEG:
            raise FrameError(f"the angle is {angle_cdeg} hundredths of a degree; it is 0 to {MAX_ANGLE_CDEG}")
        if op is OP_STOP and angle_cdeg != 0:
            raise FrameError(f"the angle of a Stop is {angle_cdeg} hundredths of a degree; a Stop has none, so 0")
        self.op = op
        self.angle_cdeg = angle_cdeg
        self.data = bytes((op, angle_cdeg // 100, angle_cdeg % 100))


class _Moves(dict[int, ServoOp]):
    """The operation for each angle, made at its first use (18001 at most). Each setpoint needs three."""

    def __init__(self, op: Op) -> None:
        self._op = op

    def __missing__(self, angle_cdeg: int) -> ServoOp:
        made = self[angle_cdeg] = ServoOp(self._op, angle_cdeg)
        return made


STOP: Final = ServoOp(OP_STOP)
STARTS: Final = _Moves(OP_START)
SETS: Final = _Moves(OP_SET)


@dataclass(slots=True, init=False, unsafe_hash=True)
class Frame:  # mutants accepted (FalseWithTrue, LeaveOut): the rest follows from the servos
    """Operations for servos of one leg: OneServo or OneLeg."""

    servos: tuple[tuple[int, ServoOp], ...]
    """The (servo id, operation) pairs of the frame, in its order."""
    leg: int = field(compare=False, repr=False)
    is_stop: bool = field(compare=False, repr=False)
    """Whether the frame only de-energises."""
    moves: bool = field(compare=False, repr=False)
    """Whether the frame de-energises no servo."""
    data: bytes = field(compare=False, repr=False)


_AT_OPS: Final = slice(3, ONE_LEG_LEN, 4)
_STOPS_ALL: Final = bytes((OP_STOP, OP_STOP, OP_STOP))


class OneServo(Frame):
    """ONE SERVO: one operation for one servo."""

    __slots__ = ()

    def __init__(self, servo_id: int, command: ServoOp) -> None:
        if servo_id not in _SERVO_ID_SET:
            raise FrameError(f"the servo id is {servo_id}; {_SERVO_ID_RULE}")
        self.servos = ((servo_id, command),)
        self.leg = servo_id // 10
        self.is_stop = command.op is OP_STOP
        self.moves = not self.is_stop
        self.data = _ONE_SERVO + _IDS[servo_id] + command.data


class OneLeg(Frame):
    """ONE LEG: one operation for each of a leg's joints 1, 2 and 3. Raises ValueError for another number of them."""

    __slots__ = ()

    def __init__(self, leg: int, commands: Sequence[ServoOp]) -> None:
        first, second, third = commands
        try:
            ids, one, two, three = _IDS_OF_LEG[leg]
        except KeyError:
            raise FrameError(f"the leg is {leg}; it is 1 to 6") from None
        self.servos = tuple(zip(ids, commands, strict=True))
        self.leg = leg
        self.data = one + first.data + two + second.data + three + third.data
        ops = self.data[_AT_OPS]
        self.is_stop = ops == _STOPS_ALL
        self.moves = OP_STOP not in ops


def frame_of(targets: tuple[tuple[int, ServoOp], ...]) -> Frame:
    """Return the frame with these operations: one servo's, or those of a leg's joints 1, 2 and 3."""
    if not targets[1:]:
        return OneServo(*targets[0])
    (first, one), (_, two), (_, three) = targets
    return OneLeg(first // 10, (one, two, three))


def bytes_of(targets: Sequence[tuple[int, ServoOp]]) -> bytes:
    """Return SERVO ID, OP, INT and FLOAT of each target, as in a frame. Unrolled for a leg's, a third of the time."""
    if len(targets) == 3:
        (one, one_op), (two, two_op), (three, three_op) = targets
        return _IDS[one] + one_op.data + _IDS[two] + two_op.data + _IDS[three] + three_op.data
    return b"".join([_IDS[servo_id] + op.data for servo_id, op in targets])


def legs_of(servo_ids: Iterable[int]) -> tuple[int, ...]:
    """Return the legs of these servos, ascending."""
    return tuple(sorted({servo_id // 10 for servo_id in servo_ids}))


def servo_ids_of(leg: int) -> tuple[int, int, int]:
    """Return the ids of a leg's joints 1 to 3, from the body outward."""
    return 10 * leg + 1, 10 * leg + 2, 10 * leg + 3


def centidegrees(angle_deg: float) -> int:
    """Return degrees as the nearest hundredths of a degree: 90.29 is 9029, but the truncated product is 9028."""
    return round(angle_deg * 100)


_STOPS: Final = {leg: OneLeg(leg, (STOP, STOP, STOP)) for leg in LEGS}


def stop_leg(leg: int) -> OneLeg:
    """Return the frame that de-energises all servos of a leg."""
    return _STOPS[leg]


_KINDS: Final = {ONE_LEG_TYPE: ("ONE LEG", ONE_LEG_LEN), ONE_SERVO_TYPE: ("ONE SERVO", ONE_SERVO_LEN)}


def decode(data: bytes) -> Frame:  # mutants accepted (Lt_LtE): an equal length is right
    """Return the frame in these bytes, of either type. Raises FrameError, which names the first wrong byte."""
    if len(data) < 2:
        raise FrameError(f"byte {len(data) + 1} is missing; a frame starts with FRAME LEN and FRAME TYPE")
    if data[1] not in _KINDS:
        raise FrameError(f"{_found(data, 1)}; a FRAME TYPE is 1 (ONE LEG) or 2 (ONE SERVO)")
    name, size = _KINDS[data[1]]
    if data[0] != size:
        raise FrameError(f"{_found(data, 0)}; the FRAME LEN of a {name} frame (FRAME TYPE {data[1]}) is {size}")
    if len(data) != size:
        wrong = f"byte {len(data) + 1} is missing" if len(data) < size else f"byte {size + 1} is too many"
        raise FrameError(f"{wrong}; a {name} frame has {size} bytes, here are {len(data)}")
    ops = []
    for joint, index in enumerate(range(2, size, 4), 1):
        if data[index] not in _SERVO_ID_SET:
            raise FrameError(f"{_found(data, index)}; {_SERVO_ID_RULE}")
        expected_id = 10 * (data[2] // 10) + joint
        if size == ONE_LEG_LEN and data[index] != expected_id:
            raise FrameError(
                f"{_found(data, index)} in place of {expected_id}; a ONE LEG frame holds joints 1, 2, 3 of one leg"
            )
        ops.append(read_op(data, index + 1))
    return OneLeg(data[2] // 10, (ops[0], ops[1], ops[2])) if size == ONE_LEG_LEN else OneServo(data[2], ops[0])


_SERVO_ID_RULE: Final = "a servo id is leg 1-6 then joint 1-3, such as 13"


def _found(data: bytes, index: int) -> str:
    return f"byte {index + 1} is {data[index]} (0x{data[index]:02x})"


def read_op(data: bytes, index: int) -> ServoOp:
    """Return the operation in the bytes from `index` on. Raises FrameError."""
    op_code, degrees, hundredths = data[index : index + 3]
    if op_code == Op.STOP:
        return STOP
    if op_code not in (Op.START, Op.SET):
        raise FrameError(f"{_found(data, index)}; an OP is 1 (Start), 2 (Stop) or 3 (Set)")
    if degrees > 180:
        raise FrameError(f"{_found(data, index + 1)}; INT PART is 0 to 180 whole degrees")
    if hundredths > 99:
        raise FrameError(f"{_found(data, index + 2)}; FLOAT PART is 0 to 99 hundredths of a degree")
    if 100 * degrees + hundredths > MAX_ANGLE_CDEG:
        raise FrameError(f"{_found(data, index + 2)} after 180 whole degrees; the largest angle is 180.00")
    return (STARTS if op_code == OP_START else SETS)[100 * degrees + hundredths]


# ---- the SPI transfers of a frame: one by the protocol document, two for the published controller firmware

ZERO: Final = b"\0"
PREAMBLE_ZEROS: Final = 16
"""Zeros that synchronise a controller that awaits an announced body: the longest body has 14 bytes.

They complete the body. The controller ignores its type 0, and lengths of 0. Each zero is its own transfer: within one
transfer they arrive faster than the firmware handles lengths of 0, which jams a healthy controller for up to a second.
Zeros that complete half a body would be ids and angles of 0.
"""


class Framing(enum.StrEnum):
    """PLAIN: a frame is one transfer. LENGTH_PREFIXED: its length is sent first, in a transfer of its own."""

    PLAIN = "plain"
    LENGTH_PREFIXED = "length-prefixed"

    @property
    def avoid_cdeg(self) -> tuple[int, int] | None:
        """Wire angles that are never sent: first <= angle < second, in hundredths of a degree; None: all are sent.

        After one lost byte the published firmware takes the whole degrees for an operation, and the operation for a
        servo's id. Ids 0 to 3 and 10 with operations 1 to 3 are a bus fault: it receives nothing until it is reset, and
        its servos stay on. One lost byte makes ids 1 to 3; more lost bytes can still kill it.
        """
        return (1_00, 4_00) if self is Framing.LENGTH_PREFIXED else None

    @property
    def least_gap_us(self) -> float:
        """The shortest pause with which the published firmware loses no frame: 20 µs held in each build, 6 µs failed in
        several."""
        return 20.0 if self is Framing.LENGTH_PREFIXED else 0.0

    @property
    def most_hz(self) -> int:
        """The highest clock: the published firmware lost nothing at 5 and 8 MHz, and 2 % at 10 MHz in one build."""
        return 5_000_000 if self is Framing.LENGTH_PREFIXED else 20_000_000

    def too_fast(self, speed_hz: int, frame_gap_us: float) -> str:
        """Return why a controller with this framing loses frames at this clock and pause, or ""."""
        faults = []
        if speed_hz > self.most_hz:
            faults.append(
                f"speed_hz is {speed_hz}, and {self} allows {self.most_hz} at most: "
                "the published firmware loses bytes of a faster clock"
            )
        if frame_gap_us < self.least_gap_us:
            faults.append(
                f"frame_gap_us is {frame_gap_us:g}, and {self} wants {self.least_gap_us:g} at least: "
                "in shorter pauses the published firmware loses frames, Stops too"
            )
        return "; ".join(faults)


def avoided_by(framing: str) -> tuple[int, int] | None:
    """Return the `avoid_cdeg` of a framing that a gateway reports; None also for an unknown framing."""
    return Framing(framing).avoid_cdeg if framing in Framing.__members__.values() else None
