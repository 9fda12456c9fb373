"""A page of memory about simulated servos: where a controller sends them, and which of them a power board feeds."""

import math
import struct
from collections.abc import Collection
from typing import Final

from gateway.host.shared_page import SharedPage
from schemas.robot import SERVO_IDS

_NUMBER: Final = struct.Struct("=d")
_PLACES: Final = {servo_id: place * _NUMBER.size for place, servo_id in enumerate(SERVO_IDS)}
_UNFED: Final = struct.Struct("=Q")
"""A bit for each servo, in the order of SERVO_IDS; a page of zeros feeds all."""
_UNFED_AT: Final = len(SERVO_IDS) * _NUMBER.size


class ServoPage(SharedPage):
    """For each of the 18 servos the angle on the wire (degrees) that it is sent to, or None while it is off.

    The simulated controller writes the angles. A simulated power board, where there is one, says which have supply.
    """

    def __init__(self, fd: int | None = None) -> None:
        """A new page, all servos off and fed; with `fd` the one that another process has made and passed on."""
        super().__init__(fd)
        if fd is None:
            for servo_id in SERVO_IDS:
                self.write(servo_id, None)

    def write(self, servo_id: int, angle_deg: float | None) -> None:
        """Send this servo there. Takes less than a microsecond."""
        _NUMBER.pack_into(self._memory, _PLACES[servo_id], math.nan if angle_deg is None else angle_deg)

    def feed(self, servo_ids: Collection[int]) -> None:
        """Exactly these have supply."""
        unfed = sum(1 << place for place, servo_id in enumerate(SERVO_IDS) if servo_id not in servo_ids)
        _UNFED.pack_into(self._memory, _UNFED_AT, unfed)

    @property
    def fed(self) -> frozenset[int]:
        """The servos that have supply; all, until somebody says otherwise."""
        (unfed,) = _UNFED.unpack_from(self._memory, _UNFED_AT)
        return frozenset(servo_id for place, servo_id in enumerate(SERVO_IDS) if not unfed >> place & 1)

    def read(self) -> dict[int, float | None]:
        """All 18 as they are now. One without supply is off."""
        angles_deg = struct.unpack_from(f"={len(SERVO_IDS)}d", self._memory)
        fed = self.fed
        return {
            servo_id: None if math.isnan(angle_deg) or servo_id not in fed else angle_deg
            for servo_id, angle_deg in zip(SERVO_IDS, angles_deg, strict=True)
        }
