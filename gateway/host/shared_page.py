"""Memory pages that two processes share: a simulated robot's servo targets, and its sensors' values.

A page has one writer, which never waits for a reader. Aligned numbers of 8 bytes are atomic.
"""

import ctypes
import math
import mmap
import os
from collections.abc import Collection
from typing import Any, Final, NamedTuple

from schemas.robot import LEGS, SERVO_IDS

_PLACES: Final = {servo_id: place for place, servo_id in enumerate(SERVO_IDS)}


def _shared(kind: type[ctypes.Structure], fd: int | None) -> tuple[int, Any]:
    """Return a page's descriptor and content: all zeros, or of another process's page by its descriptor `fd`."""
    found = os.memfd_create("page") if fd is None else fd  # a file in memory, so a write never waits for a disk
    if fd is None:
        os.ftruncate(found, mmap.PAGESIZE)
    return found, kind.from_buffer(mmap.mmap(found, mmap.PAGESIZE))


class _Targets(ctypes.Structure):
    _fields_ = (("angles_deg", ctypes.c_double * len(SERVO_IDS)), ("unfed", ctypes.c_uint64))
    """`unfed` has a bit for each servo without power, in the order of SERVO_IDS."""


class ServoPage:
    """The wire angle in degrees to which each of the 18 servos is sent, or None for a servo that is off.

    The simulated controller writes the angles. A simulated power board, if there is one, writes which are powered.
    """

    def __init__(self, fd: int | None = None) -> None:
        """Make a page with all servos off and powered, or open another process's page by its descriptor `fd`."""
        self.fd, self._page = _shared(_Targets, fd)
        for servo_id in SERVO_IDS if fd is None else ():
            self.write(servo_id, None)

    def write(self, servo_id: int, angle_deg: float | None) -> None:
        """Send this servo to a wire angle; None: off. Takes less than a microsecond."""
        self._page.angles_deg[_PLACES[servo_id]] = math.nan if angle_deg is None else angle_deg

    def feed(self, servo_ids: Collection[int]) -> None:
        """Power exactly these servos."""
        self._page.unfed = sum(1 << place for servo_id, place in _PLACES.items() if servo_id not in servo_ids)

    @property
    def fed(self) -> frozenset[int]:
        """The powered servos; all, unless a board writes otherwise."""
        unfed = self._page.unfed
        return frozenset(servo_id for servo_id, place in _PLACES.items() if not unfed >> place & 1)

    def read(self) -> dict[int, float | None]:
        """Return the wire angle of each servo in degrees, or None for a servo that is off or has no power."""
        targets_deg, fed = zip(SERVO_IDS, self._page.angles_deg, strict=True), self.fed
        return {servo_id: None if math.isnan(deg) or servo_id not in fed else deg for servo_id, deg in targets_deg}


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


class _Copy(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_double * count)
        for name, count in zip(Sensed._fields, (4, 3, 3, len(LEGS), len(SERVO_IDS)), strict=True)
    )


class _Copies(ctypes.Structure):
    _fields_ = (("newest", ctypes.c_int64), ("copies", _Copy * 2))
    """`newest` is 1 or 2; 0 before the first."""


class SensedPage:
    """The newest `Sensed`. Each goes into the older of two copies, so a reader never gets a half-written one."""

    def __init__(self, fd: int | None = None) -> None:
        self.fd, self._page = _shared(_Copies, fd)

    def write(self, sensed: Sensed) -> None:
        """Write the newest values. Takes microseconds."""
        place = 2 if self._page.newest == 1 else 1
        for name, values in sensed._asdict().items():
            setattr(self._page.copies[place - 1], name, values)
        self._page.newest = place

    def read(self) -> Sensed | None:
        """Return the newest values, or None before the first."""
        newest = self._page.newest
        copy = self._page.copies[newest - 1]
        return Sensed(*(tuple(getattr(copy, name)) for name in Sensed._fields)) if newest else None
