"""A page of memory in which a simulated controller writes where its servos are sent, for a simulated body."""

import math
import struct
from typing import Final

from gateway.host.shared_page import SharedPage
from schemas.robot import SERVO_IDS

_NUMBER: Final = struct.Struct("=d")
_PLACES: Final = {servo_id: place * _NUMBER.size for place, servo_id in enumerate(SERVO_IDS)}


class ServoPage(SharedPage):
    """For each of the 18 servos the angle on the wire (degrees) that it is sent to, or None while it is off."""

    def __init__(self, fd: int | None = None) -> None:
        """A new page, all servos off; with `fd` the one that another process has made and passed on."""
        super().__init__(fd)
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
