"""Pages of memory that two processes share, about a simulated robot: where its servos are sent, and what it feels."""

import math
import mmap
import os
import struct
from collections.abc import Collection
from typing import Final, NamedTuple

from schemas.robot import LEGS, SERVO_IDS

_NUMBER: Final = struct.Struct("=d")
_PLACES: Final = {servo_id: place * _NUMBER.size for place, servo_id in enumerate(SERVO_IDS)}
_UNFED: Final = struct.Struct("=Q")
"""A bit for each servo, in the order of SERVO_IDS; a page of zeros feeds all."""
_UNFED_AT: Final = len(SERVO_IDS) * _NUMBER.size
_NEWEST: Final = struct.Struct("=q")
"""Which of the two copies is the newest, 1 or 2; 0 before the first."""
_NUMBERS: Final = struct.Struct(f"=4d3d3d{len(LEGS)}d{len(SERVO_IDS)}d")


class SharedPage:
    """It goes one way, and the writer never waits: it does not notice whether anybody reads, or is too slow.

    An aligned number of eight bytes is written whole.
    """

    def __init__(self, fd: int | None = None) -> None:
        """A new page of zeros; with `fd` the one that another process has made and passed on."""
        self.fd = os.memfd_create("page") if fd is None else fd
        """No disk is behind it, so a write never waits for one."""
        if fd is None:
            os.ftruncate(self.fd, mmap.PAGESIZE)
        self._memory = mmap.mmap(self.fd, mmap.PAGESIZE)


class ServoPage(SharedPage):
    """For each of the 18 servos the angle on the wire (degrees) that it is sent to, or None while it is off.

    The simulated controller writes the angles. A simulated power board, where there is one, writes which have supply.
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
        """The servos that have supply; all, until a board writes otherwise."""
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


class Sensed(NamedTuple):
    """What the sensors of a robot feel, in the body's frame: x forward, y left, z up."""

    orientation_wxyz: tuple[float, float, float, float]
    angular_velocity_rad_s: tuple[float, float, float]
    linear_acceleration_m_s2: tuple[float, float, float]
    """As an accelerometer has it: 9.81 upward at rest."""
    feet_n: tuple[float, ...]
    """The ground's force on the foot of legs 1 to 6."""
    torques_nm: tuple[float, ...]
    """Of the 18 servos, in the order of SERVO_IDS."""


class SensedPage(SharedPage):
    """The newest `Sensed`. Each goes into the older of two copies, so a reader never meets one that is half written."""

    def write(self, sensed: Sensed) -> None:
        """This is the newest. Takes microseconds."""
        place = 2 if self._newest == 1 else 1
        orientation, turning, acceleration, feet_n, torques_nm = sensed
        _NUMBERS.pack_into(self._memory, _offset(place), *orientation, *turning, *acceleration, *feet_n, *torques_nm)
        _NEWEST.pack_into(self._memory, 0, place)

    def read(self) -> Sensed | None:
        """The newest; None before the first."""
        place = self._newest
        if not place:
            return None
        w, x, y, z, *rest = _NUMBERS.unpack_from(self._memory, _offset(place))
        return Sensed(
            (w, x, y, z),
            (rest[0], rest[1], rest[2]),
            (rest[3], rest[4], rest[5]),
            tuple(rest[6 : 6 + len(LEGS)]),
            tuple(rest[6 + len(LEGS) :]),
        )

    @property
    def _newest(self) -> int:
        (place,) = _NEWEST.unpack_from(self._memory)
        return int(place)


def _offset(place: int) -> int:
    return _NEWEST.size + (place - 1) * _NUMBERS.size
