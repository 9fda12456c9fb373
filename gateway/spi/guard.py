"""Checks each transfer: only legal frames, their announcements and the preamble reach SPI.

The encoder cannot build anything else, so a rejection here is a bug of the gateway. The controller checks neither ids
nor lengths and would corrupt its memory, which is why the bytes are checked a second time.
"""

from contextlib import AbstractContextManager
from typing import Final

from gateway.protocol.frames import (
    ONE_LEG_LEN,
    ONE_LEG_TYPE,
    ONE_SERVO_LEN,
    ONE_SERVO_TYPE,
    FrameError,
    Op,
    decode,
    servo_ids_of,
)
from gateway.protocol.framing import Framing
from gateway.spi import SpiDevice
from schemas.robot import LEGS, SERVO_IDS

_ANNOUNCEMENTS: Final = frozenset((bytes((ONE_SERVO_LEN,)), bytes((ONE_LEG_LEN,))))
_ONE_LEG: Final = bytes((ONE_LEG_LEN, ONE_LEG_TYPE))
_ONE_SERVO: Final = bytes((ONE_SERVO_LEN, ONE_SERVO_TYPE))
_ZERO: Final = b"\0"
_ZEROS_FOR_A_BODY: Final = 16  # no fewer: fewer than 14 would leave the rest of a body to the next frame

_IDS_OF_LEGS: Final = frozenset(servo_ids_of(leg) for leg in LEGS)
_STOP: Final = int(Op.STOP)
_MOVES: Final = frozenset((int(Op.START), int(Op.SET)))


class IllegalTransferError(RuntimeError):
    """The gateway tried to write an illegal transfer: a bug in it, never a fault of the caller or the wire."""


class GuardedDevice:
    """An SPI device that rejects every transfer which `framing` does not make of a legal frame, before any byte leaves.

    PLAIN: legal are frames. Length-prefixed: what is legal depends on what the controller awaits, by what was written:

    * A length: legal are an announcement, or a zero, which the controller ignores. Any number of zeros, since a Stop
      may interrupt a preamble and the rest of it follows.
    * A body: legal are a frame of exactly the announced length, or a zero, which begins to replace the body.
    * The rest of a body that zeros replace: legal are zeros only, until all sixteen of the preamble are written. The
      controller would take a frame for the rest of the body.

    After a failed transfer nobody knows what the controller received. The guard then assumes that it awaits a length,
    so that a Stop can still be tried.
    """

    def __init__(self, device: SpiDevice, framing: Framing) -> None:
        self._device = device
        self._announces = framing is Framing.LENGTH_PREFIXED
        self._announced_len: int | None = None
        self._filled = 0  # zeros written instead of the announced body

    def transfer(self, data: bytes) -> None:
        """Pass a legal transfer on. Raises IllegalTransferError, with nothing changed, or the device's SpiError."""
        announced_len, filled = self._checked(data)
        self._announced_len, self._filled = None, 0
        self._device.transfer(data)
        self._announced_len, self._filled = announced_len, filled

    def lock(self) -> AbstractContextManager[None]:
        """The device's bus lock."""
        return self._device.lock()

    def stop_servos_at_work(self) -> bool:
        """As the device sees it."""
        return self._device.stop_servos_at_work()

    def close(self) -> None:
        """Release the device."""
        self._device.close()

    def _checked(self, data: bytes) -> tuple[int | None, int]:
        """The body's length that the controller awaits after this transfer, and how many zeros replace that body."""
        announced_len = self._announced_len
        if self._announces and data == _ZERO:
            filled = 0 if announced_len is None else self._filled + 1
            return (announced_len, filled) if 0 < filled < _ZEROS_FOR_A_BODY else (None, 0)
        if self._filled:
            raise IllegalTransferError(f"[{data.hex(' ')}] interrupts the zeros that replace a body")
        if self._announces and announced_len is None:
            if data not in _ANNOUNCEMENTS:
                raise IllegalTransferError(f"[{data.hex(' ')}] announces no frame; 06 or 0e does")
            return data[0], 0
        if announced_len is not None and len(data) != announced_len:
            raise IllegalTransferError(f"[{data.hex(' ')}] is not the frame of {announced_len} bytes announced")
        if _is_frame(data):
            return None, 0
        try:
            canonical = decode(data).to_bytes()
        except FrameError as error:
            raise IllegalTransferError(f"[{data.hex(' ')}] is no frame: {error}") from error
        if data != canonical:
            raise IllegalTransferError(f"[{data.hex(' ')}] is not how this frame is written: [{canonical.hex(' ')}]")
        return None, 0


def _is_frame(data: bytes) -> bool:
    """Whether these are a legal frame's bytes. Four times faster than `decode`, which says why not."""
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
        else:
            legal = op == _STOP and whole_deg == hundredths == 0
        if not legal:
            return False
    return True
