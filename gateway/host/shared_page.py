"""Memory pages that two processes share: a simulated robot's servo targets, and its sensors' values."""

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
"""A bit for each servo without power, in the order of SERVO_IDS; a page of zeros powers all."""
_UNFED_AT: Final = len(SERVO_IDS) * _NUMBER.size
_NEWEST: Final = struct.Struct("=q")
"""Which of the two copies is the newest, 1 or 2; 0 before the first."""
_NUMBERS: Final = struct.Struct(f"=4d3d3d{len(LEGS)}d{len(SERVO_IDS)}d")


class SharedPage:
    """A page from one writer to readers, for which the writer never waits. Aligned numbers of 8 bytes are atomic."""

    def __init__(self, fd: int | None = None) -> None:
        """Make a page of zeros, or open another process's page by its descriptor `fd`."""
        self.fd = os.memfd_create("page") if fd is None else fd
        """A file in memory, so a write never waits for a disk."""
        if fd is None:
            os.ftruncate(self.fd, mmap.PAGESIZE)
        self._memory = mmap.mmap(self.fd, mmap.PAGESIZE)


class ServoPage(SharedPage):
    """The wire angle in degrees to which each of the 18 servos is sent, or None for a servo that is off.

    The simulated controller writes the angles. A simulated power board, if there is one, writes which are powered.
    """

    def __init__(self, fd: int | None = None) -> None:
        """Make a page with all servos off and powered, or open another process's page by its descriptor `fd`."""
        super().__init__(fd)
        if fd is None:
            for servo_id in SERVO_IDS:
                self.write(servo_id, None)

    def write(self, servo_id: int, angle_deg: float | None) -> None:
        """Send this servo to a wire angle; None: off. Takes less than a microsecond."""
        _NUMBER.pack_into(self._memory, _PLACES[servo_id], math.nan if angle_deg is None else angle_deg)

    def feed(self, servo_ids: Collection[int]) -> None:
        """Power exactly these servos."""
        unfed = sum(1 << place for place, servo_id in enumerate(SERVO_IDS) if servo_id not in servo_ids)
        _UNFED.pack_into(self._memory, _UNFED_AT, unfed)

    @property
    def fed(self) -> frozenset[int]:
        """The powered servos; all, unless a board writes otherwise."""
        (unfed,) = _UNFED.unpack_from(self._memory, _UNFED_AT)
        return frozenset(servo_id for place, servo_id in enumerate(SERVO_IDS) if not unfed >> place & 1)

    def read(self) -> dict[int, float | None]:
        """Return the wire angle of each servo in degrees, or None for a servo that is off or has no power."""
        angles_deg = struct.unpack_from(f"={len(SERVO_IDS)}d", self._memory)
        fed = self.fed
        return {
            servo_id: None if math.isnan(angle_deg) or servo_id not in fed else angle_deg
            for servo_id, angle_deg in zip(SERVO_IDS, angles_deg, strict=True)
        }


class Sensed(NamedTuple):
    """A robot's sensor values, in the body's frame: x forward, y left, z up."""

    orientation_wxyz: tuple[float, float, float, float]
    angular_velocity_rad_s: tuple[float, float, float]
    linear_acceleration_m_s2: tuple[float, float, float]
    """As an accelerometer measures it: 9.81 upward at rest."""
    feet_n: tuple[float, ...]
    """The ground's force on the feet of legs 1 to 6."""
    torques_nm: tuple[float, ...]
    """The servos' torques, in the order of SERVO_IDS."""


class SensedPage(SharedPage):
    """The newest `Sensed`. Each goes into the older of two copies, so a reader never gets a half-written one."""

    def write(self, sensed: Sensed) -> None:
        """Write the newest values. Takes microseconds."""
        place = 2 if self._newest == 1 else 1
        orientation, turning, acceleration, feet_n, torques_nm = sensed
        _NUMBERS.pack_into(self._memory, _offset(place), *orientation, *turning, *acceleration, *feet_n, *torques_nm)
        _NEWEST.pack_into(self._memory, 0, place)

    def read(self) -> Sensed | None:
        """Return the newest values, or None before the first."""
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
