"""Memory pages that two processes share: a simulated robot's servo targets, and its sensors' values.

A page has one writer, which never waits for a reader. Aligned numbers of 8 bytes are atomic.
"""

import math
import mmap
import os
from array import array
from collections.abc import Collection
from itertools import chain, islice
from typing import Any, Final, NamedTuple

from schemas.robot import LEGS, SERVO_IDS

_PLACES: Final = {servo_id: place for place, servo_id in enumerate(SERVO_IDS)}
_UNFED: Final = len(SERVO_IDS)
"""Place of a number with a bit for each servo without power, in the order of SERVO_IDS."""


def _shared(fd: int | None) -> "tuple[int, memoryview[float]]":
    """Return a page's descriptor and its floats: all 0, or of another process's page by its descriptor `fd`."""
    found = os.memfd_create("page") if fd is None else fd  # a file in memory, so a write never waits for a disk
    if fd is None:
        os.ftruncate(found, mmap.PAGESIZE)
    return found, memoryview(mmap.mmap(found, mmap.PAGESIZE)).cast("d")


class ServoPage:
    """The wire angle in degrees to which each of the 18 servos is sent, or None for a servo that is off.

    The simulated controller writes the angles. A simulated power board, if there is one, writes which are powered.
    """

    def __init__(self, fd: int | None = None) -> None:
        """Make a page with all servos off and powered, or open another process's page by its descriptor `fd`."""
        self.fd, self._page = _shared(fd)
        for servo_id in SERVO_IDS if fd is None else ():
            self.write(servo_id, None)

    def write(self, servo_id: int, angle_deg: float | None) -> None:
        """Send this servo to a wire angle; None: off. Takes less than a microsecond."""
        self._page[_PLACES[servo_id]] = math.nan if angle_deg is None else angle_deg

    def feed(self, servo_ids: Collection[int]) -> None:
        """Power exactly these servos."""
        self._page[_UNFED] = sum(1 << place for servo_id, place in _PLACES.items() if servo_id not in servo_ids)

    @property
    def fed(self) -> frozenset[int]:
        """The powered servos; all, unless a board writes otherwise."""
        unfed = int(self._page[_UNFED])
        return frozenset(servo_id for servo_id, place in _PLACES.items() if not unfed >> place & 1)

    def read(self) -> dict[int, float | None]:
        """Return the wire angle of each servo in degrees, or None for a servo that is off or has no power."""
        targets_deg, fed = zip(SERVO_IDS, self._page[:_UNFED], strict=True), self.fed
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


_COUNTS: Final = (4, 3, 3, len(LEGS), len(SERVO_IDS))
"""How many numbers each field has."""
_SIZE: Final = sum(_COUNTS)


class SensedPage:
    """The newest `Sensed`. Each goes into the older of two copies, so a reader never gets a half-written one."""

    def __init__(self, fd: int | None = None) -> None:
        self.fd, self._page = _shared(fd)

    def write(self, sensed: Sensed) -> None:
        """Write the newest values. Takes microseconds."""
        newest = 2 if self._page[0] == 1 else 1
        self._copy(newest)[:] = array("d", chain(*sensed))
        self._page[0] = newest

    def read(self) -> Sensed | None:
        """Return the newest values, or None before the first."""
        newest = int(self._page[0])
        if not newest:
            return None
        values = iter(self._copy(newest).tolist())
        fields: Any = (tuple(islice(values, count)) for count in _COUNTS)
        return Sensed(*fields)

    def _copy(self, newest: int) -> "memoryview[float]":
        """Return a copy's numbers. The page begins with the number of the newest: 1 or 2; 0 before the first."""
        return self._page[1 + (newest - 1) * _SIZE :][:_SIZE]
