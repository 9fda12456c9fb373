"""Checks each transfer of a batch: only legal frames, their announcements and the preamble reach SPI.

The encoder builds nothing else, so a rejection here is a bug of the gateway. The bytes are checked a second time since
the controller checks neither ids nor lengths, and would corrupt its memory. So this has its own description of a frame.
"""

import re
from operator import itemgetter
from typing import Final

from gateway.model.frames import ONE_LEG_LEN, ONE_LEG_TYPE, ONE_SERVO_LEN, ONE_SERVO_TYPE, OP_STOP, Op, servo_ids_of
from gateway.robot.spi import Batch
from schemas.robot import LEGS, SERVO_IDS

_ANNOUNCEMENTS: Final = frozenset((bytes((ONE_SERVO_LEN,)), bytes((ONE_LEG_LEN,))))
_OPERATION: Final = rb"(?:%c\0\0|[%c%c](?:[\0-\xb3][\0-\x63]|\xb4\0))" % (Op.STOP, Op.START, Op.SET)
"""A Stop without an angle, or a Start or Set to 0.00 to 180.00 degrees, in whole degrees and hundredths."""
_OF_SERVO: Final = {servo_id: re.escape(bytes((servo_id,))) + _OPERATION for servo_id in SERVO_IDS}
_OF_LEG: Final = [b"".join(_OF_SERVO[servo_id] for servo_id in servo_ids_of(leg)) for leg in LEGS]
_FRAME: Final = re.compile(
    rb"%c%c(?:%b)|%c%c(?:%b)"
    % (ONE_LEG_LEN, ONE_LEG_TYPE, b"|".join(_OF_LEG), ONE_SERVO_LEN, ONE_SERVO_TYPE, b"|".join(_OF_SERVO.values())),
    re.DOTALL,
)
_data_of: Final = itemgetter(0)


class IllegalTransferError(RuntimeError):
    """The gateway tried to write an illegal transfer: its own bug, never a fault of the caller or the wire."""


# mutants accepted (Forget, Step): a shortcut; an announcement's first byte is its last
def check(batch: Batch, avoid_cdeg: range, *, announces: bool) -> None:
    """Raise IllegalTransferError unless a batch is legal. Call it before any byte leaves.

    Frames are legal. If frames are announced (LENGTH_PREFIXED framing), an announcement directly followed by a frame of
    that length is legal, and zeros between frames. A batch ends with a whole frame or with zeros. A frame that moves a
    servo to an angle of `avoid_cdeg` (see `Framing.avoid_cdeg`) is illegal.
    """
    if not announces and not avoid_cdeg and all(map(_FRAME.fullmatch, map(_data_of, batch))):
        return  # without Python's loop, which takes as long as the rest of a call with six frames
    announced_len = None
    for data, _ in batch:
        if announces and announced_len is None:
            if data in _ANNOUNCEMENTS:
                announced_len = data[0]
            elif data != b"\0":
                raise IllegalTransferError(f"[{data.hex(' ')}] announces no frame; 06 or 0e does")
            continue
        if announced_len is not None and len(data) != announced_len:
            raise IllegalTransferError(f"[{data.hex(' ')}] is not the frame of {announced_len} bytes announced")
        announced_len = None
        if not _FRAME.fullmatch(data):
            raise IllegalTransferError(f"[{data.hex(' ')}] is no frame of the protocol")
        for at in range(2, len(data), 4) if avoid_cdeg else ():
            servo_id, op, whole_deg, hundredths = data[at : at + 4]
            angle_cdeg = whole_deg * 100 + hundredths
            if op != OP_STOP and angle_cdeg in avoid_cdeg:
                angle = f"servo {servo_id} to {angle_cdeg / 100:g} degrees"
                raise IllegalTransferError(f"[{data.hex(' ')}] moves {angle}, which is never sent in this framing")
    if announced_len is not None:
        raise IllegalTransferError(f"the frame of {announced_len} bytes announced is in no batch")
