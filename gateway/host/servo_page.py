"""A page of memory in which a simulated controller writes where its servos are sent, for the simulation of the rest.

It goes one way, and the writer never waits: it does not notice whether anybody reads, or is too slow. An aligned number
of eight bytes is written whole.
"""

import math
import mmap
import os
import struct
from typing import Final

from schemas.robot import SERVO_IDS

_NUMBER: Final = struct.Struct("=d")
_PLACES: Final = {servo_id: place * _NUMBER.size for place, servo_id in enumerate(SERVO_IDS)}
_BYTES: Final = mmap.PAGESIZE


class ServoPage:
    """For each of the 18 servos the angle on the wire (degrees) that it is sent to, or None while it is off."""

    def __init__(self, fd: int | None = None) -> None:
        """A new page, all servos off; with `fd` the one that another process has made and passed on."""
        self.fd = os.memfd_create("servos") if fd is None else fd
        """No disk is behind it, so a write never waits for one."""
        if fd is None:
            os.ftruncate(self.fd, _BYTES)
        self._memory = mmap.mmap(self.fd, _BYTES)
        if fd is None:
            for servo_id in SERVO_IDS:
                self.write(servo_id, None)

    def write(self, servo_id: int, angle_deg: float | None) -> None:
        """Send this servo there. Takes less than a microsecond."""
        _NUMBER.pack_into(self._memory, _PLACES[servo_id], math.nan if angle_deg is None else angle_deg)

    def read(self) -> dict[int, float | None]:
        """All 18 as they are now."""
        angles_deg = struct.unpack_from(f"={len(SERVO_IDS)}d", self._memory)
        return {
            servo_id: None if math.isnan(angle_deg) else angle_deg
            for servo_id, angle_deg in zip(SERVO_IDS, angles_deg, strict=True)
        }
