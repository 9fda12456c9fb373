"""A page of memory in which a simulated body writes what its sensors feel, for a simulated controller."""

import struct
from typing import Final, NamedTuple

from gateway.host.shared_page import SharedPage
from schemas.robot import LEGS, SERVO_IDS

_NEWEST: Final = struct.Struct("=q")
"""Which of the two copies is the newest, 1 or 2; 0 before the first."""
_NUMBERS: Final = struct.Struct(f"=4d3d3d{len(LEGS)}d{len(SERVO_IDS)}d")


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
