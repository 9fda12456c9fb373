"""Notices a gait that counts in radians: every angle is legal, and the robot hardly moves."""

import math
from collections.abc import Iterable
from typing import Final

MOST_DEG: Final = 3.2
"""Half a turn in radians, and a little more for arithmetic."""
LOOK_S: Final = 1.0
"""A whole stride of most gaits; a leg in degrees is not between 0 and 3.2 for so long but on purpose."""
LIKE_RADIANS: Final = (
    f"all angles of this stream were between 0 and {MOST_DEG:g} for {LOOK_S:g} s; angles are degrees, and these look "
    "like radians (math.degrees() converts them)"
)


class Radians:
    """Looks at the angles of a stream until one is too large to be radians. Pure.

    >>> radians = Radians()
    >>> [radians.suspected([(1.57, 0.8, 2.1)], now_s) for now_s in (0.0, 0.9, 1.0, 1.1)]
    [False, False, True, False]
    """

    def __init__(self) -> None:
        self._warn_at_s: float | None = None

    def suspected(self, angles_deg: Iterable[tuple[float, ...]], now_s: float) -> bool:
        """Whether all that was given for LOOK_S looks like radians; true once at most."""
        if self._warn_at_s == math.inf:
            return False
        if any(angle > MOST_DEG for angles in angles_deg for angle in angles):
            self._warn_at_s = math.inf
            return False
        if self._warn_at_s is None:
            self._warn_at_s = now_s + LOOK_S
        suspected = now_s >= self._warn_at_s
        if suspected:
            self._warn_at_s = math.inf
        return suspected
