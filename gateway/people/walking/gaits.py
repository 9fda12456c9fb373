"""The gaits: when each leg swings. Pure.

To add a gait, add a line to the table: the page, the keys and help of `walk`, and the bridge's numbers follow it.
"""

from typing import Final, NamedTuple

from gateway.errors import WalkError
from schemas.robot import LEGS


class Gait(NamedTuple):
    """Each leg swings once in a stride. Legs 1, 3, 5 are the left ones from the front, 2, 4, 6 the right ones."""

    period_s: float
    """The duration of a stride: one swing and one stance of each leg."""
    duty: float
    """The part of a stride in which a leg stands."""
    lifts: tuple[float, float, float, float, float, float]
    """When legs 1 to 6 lift off, as parts of a stride."""

    @property
    def swing_s(self) -> float:
        """How long a foot is in the air in a stride, in seconds."""
        return (1 - self.duty) * self.period_s

    @property
    def stance_s(self) -> float:
        """How long a foot stands in a stride, in seconds."""
        return self.duty * self.period_s


GAITS: Final = {
    #              period  duty      leg 1    2    3    4    5    6
    "tripod": Gait(1.00, 0.54, (0 / 2, 1 / 2, 1 / 2, 0 / 2, 0 / 2, 1 / 2)),
    "ripple": Gait(1.80, 0.70, (4 / 6, 1 / 6, 2 / 6, 5 / 6, 0 / 6, 3 / 6)),
    "wave": Gait(3.20, 0.85, (2 / 6, 5 / 6, 1 / 6, 4 / 6, 0 / 6, 3 / 6)),
}
"""A duty slightly above 1/2, 2/3 or 5/6 leaves time to shift the load from foot to foot."""

NUMBERS: Final = dict(enumerate(dict.fromkeys(("wave", "ripple", "tripod", *GAITS))))
"""The gaits' numbers on ROS 2: first those of the Elkapod's own stack, then the others."""

TRIPODS: Final = ((1, 4, 5), (2, 3, 6))
"""The robot can stand on each: the front and rear leg of one side, and the middle leg of the other."""


def gait(name: str) -> Gait:
    """Return the gait of this name. Raises WalkError if there is none."""
    try:
        return GAITS[name]
    except (KeyError, TypeError):
        raise WalkError(f"there is no gait {name!r}; there are {', '.join(GAITS)}") from None


def phase(of: Gait, leg: int, clock: float) -> float:
    """Return how far a leg is in its stride, 0 to 1. It lifts off at 0 and lands at 1 - duty. `clock`: in strides."""
    return (clock - of.lifts[leg - LEGS.start]) % 1.0
