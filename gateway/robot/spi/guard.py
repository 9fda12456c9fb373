"""Checks each transfer of a batch: only legal frames, their announcements and the preamble reach SPI.

The encoder builds nothing else, so a rejection here is a bug of the gateway. The bytes are checked a second time since
the controller checks neither ids nor lengths, and would corrupt its memory.
"""

from typing import Final

from gateway.model.frames import (
    ONE_LEG_LEN,
    ONE_LEG_TYPE,
    ONE_SERVO_LEN,
    ONE_SERVO_TYPE,
    FrameError,
    Op,
    decode,
    servo_ids_of,
)
from gateway.model.framing import Framing
from gateway.robot.spi import Batch, SpiDevice
from schemas.robot import LEGS, SERVO_IDS

_ANNOUNCEMENTS: Final = frozenset((bytes((ONE_SERVO_LEN,)), bytes((ONE_LEG_LEN,))))
_ONE_LEG: Final = bytes((ONE_LEG_LEN, ONE_LEG_TYPE))
_ONE_SERVO: Final = bytes((ONE_SERVO_LEN, ONE_SERVO_TYPE))
_ZERO: Final = b"\0"

_IDS_OF_LEGS: Final = frozenset(servo_ids_of(leg) for leg in LEGS)
_STOP: Final = int(Op.STOP)
_MOVES: Final = frozenset((int(Op.START), int(Op.SET)))


class IllegalTransferError(RuntimeError):
    """The gateway tried to write an illegal transfer: its own bug, never a fault of the caller or the wire."""


class Guard:
    """Rejects every illegal batch before any byte leaves.

    With PLAIN framing, frames are legal. With LENGTH_PREFIXED framing, an announcement directly followed by a frame of
    that length is legal, and zeros between frames. A batch ends with a whole frame or with zeros.

    A frame that moves a servo to an angle of `avoid_cdeg` (first included, second not; see `Framing.avoid_cdeg`) is
    illegal. Stops have no angle.
    """

    # mutants accepted (Step): the interval stays empty
    def __init__(self, device: SpiDevice, framing: Framing, avoid_cdeg: tuple[int, int] | None = None) -> None:
        self._device = device
        self._announces = framing is Framing.LENGTH_PREFIXED
        self._avoid_cdeg = avoid_cdeg or (0, 0)

    def transfer(self, batch: Batch) -> None:
        """Write a legal batch. Raises IllegalTransferError before anything is written, or the device's SpiError."""
        announced_len = None
        for data, _ in batch:
            if self._announces and announced_len is None:
                if data != _ZERO:
                    announced_len = _announced_len(data)
                continue
            if announced_len is not None and len(data) != announced_len:
                raise IllegalTransferError(f"[{data.hex(' ')}] is not the frame of {announced_len} bytes announced")
            announced_len = None
            if not _is_frame(data, *self._avoid_cdeg):
                _check_frame(data, *self._avoid_cdeg)
        if announced_len is not None:
            raise IllegalTransferError(f"the frame of {announced_len} bytes announced is in no batch")
        self._device.transfer(batch)


def _announced_len(data: bytes) -> int:  # mutants accepted (Step): its first byte is its last
    if data not in _ANNOUNCEMENTS:
        raise IllegalTransferError(f"[{data.hex(' ')}] announces no frame; 06 or 0e does")
    return data[0]


def _check_frame(data: bytes, avoid_from_cdeg: int, avoid_to_cdeg: int) -> None:
    try:
        frame = decode(data)
    except FrameError as error:
        raise IllegalTransferError(f"[{data.hex(' ')}] is no frame: {error}") from error
    canonical = frame.to_bytes()
    if data != canonical:
        raise IllegalTransferError(f"[{data.hex(' ')}] is not how this frame is written: [{canonical.hex(' ')}]")
    for servo_id, command in frame.servos:
        if command.op is not Op.STOP and avoid_from_cdeg <= command.angle_cdeg < avoid_to_cdeg:
            angle = f"servo {servo_id} to {command.angle_cdeg / 100:g} degrees"
            raise IllegalTransferError(f"[{data.hex(' ')}] moves {angle}, which is never sent in this framing")


def _is_frame(data: bytes, avoid_from_cdeg: int, avoid_to_cdeg: int) -> bool:
    """Return whether these are a legal frame's bytes. Four times faster than `decode`, which gives the reason."""
    size = len(data)
    if data[:2] == _ONE_LEG and size == ONE_LEG_LEN:
        ids = (data[2], data[6], data[10])
        known = ids in _IDS_OF_LEGS
    else:
        known = data[:2] == _ONE_SERVO and size == ONE_SERVO_LEN and data[2] in SERVO_IDS
    if not known:
        return False
    for index in range(3, size, 4):
        op, whole_deg, hundredths = data[index], data[index + 1], data[index + 2]
        if op in _MOVES:
            legal = hundredths <= 99 and whole_deg <= (179 if hundredths else 180)
            legal = legal and not avoid_from_cdeg <= whole_deg * 100 + hundredths < avoid_to_cdeg
        else:
            legal = op == _STOP and whole_deg == hundredths == 0
        if not legal:
            return False
    return True
