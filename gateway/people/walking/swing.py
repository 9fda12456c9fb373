"""A walk between two ticks: its feet in the air, and how they come down, as expected or as felt. Pure."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple, Self

from gateway.geometry.kinematics import Vector
from gateway.people.walking.balance import DEEPEST_M, EARLY_M, LAG_FORGOTTEN, LATE_S, SINKS_M_S
from gateway.people.walking.motion import ORIGIN, STILL, Odometry, Velocity
from gateway.people.walking.ways import Figure

_ALMOST: Final = 1e-9


class Swing(NamedTuple):
    """A foot in the air: where it left the ground, which moves on below it, and how far it is, 0 to 1."""

    left: Vector
    part: float = 0.0
    free: bool = False
    """Whether its foot was felt to be in the air: only then a contact is news."""
    late_s: float = 0.0
    """For how long it has been where the ground was expected."""

    def down(self, height_m: float, now_m: float, touches: bool | None, seconds: float, waits_s: float) -> "Descent":
        """A tick later. `height_m`: where the gait wants the foot, which is at `now_m`; `touches`: None: unknown.

        It waits for its contact for `waits_s` before it goes on down, and longer at the lowest point: sensors are late.
        """
        free = self.free or touches is False
        if free and touches and (self.late_s or (self.part > 0.5 and now_m > EARLY_M)):
            return Descent(now_m)
        if self.part <= 1.0 - _ALMOST:
            return Descent(height_m, self._replace(free=free))
        if not free or touches is not False:
            return Descent(now_m if self.late_s else 0.0)
        if self.late_s > waits_s + DEEPEST_M / SINKS_M_S + LATE_S:
            return Descent(now_m, hangs=True)
        lower_m = max(-DEEPEST_M, now_m - SINKS_M_S * seconds) if self.late_s > waits_s else 0.0
        return Descent(lower_m, self._replace(free=True, late_s=self.late_s + seconds))


class Descent(NamedTuple):
    """Where the foot is, and its swing, if it has not come down."""

    height_m: float
    swing: Swing | None = None
    hangs: bool = False
    """It found no ground as far down as it may go."""


@dataclass(slots=True)
class State(Figure):
    """All that a tick changes. A tick that is too fast is undone, so it works on a copy; the values are immutable."""

    swings: dict[int, Swing] = field(default_factory=dict)
    velocity: Velocity = STILL
    tempo: float = 1.0
    """The part of its gait's period that a stride takes now."""
    clock: float = 0.0
    """The time in strides."""
    odometry: Odometry = ORIGIN
    part: float = 0.0
    """How much of the first of its moves is done, 0 to 1."""
    rests: dict[int, Vector] = field(default_factory=dict)
    """Where the feet rest that were set down further out than their stance has them, since the body leans."""
    lag_s: float = LATE_S
    """How much later than its feet arrive on the ground their contact is reported."""
    hanging: frozenset[int] = frozenset()
    """Legs whose feet found no ground, when the walk went `over`."""
    over: Velocity = STILL
    brake_s: float = 0.0
    """Seconds until the velocity is 0, while it slows down."""

    def copy(self) -> Self:
        new = Figure.copy(self)
        new.swings, new.rests = dict(self.swings), dict(self.rests)
        return new

    def landed(self, leg: int, touches: bool | None, *, hangs: bool, over: Velocity) -> None:
        """End a swing. `touches`: whether its foot is felt on the ground; `over`: the velocity, if it `hangs`."""
        swing = self.swings.pop(leg)
        if touches and swing.free and swing.late_s <= LATE_S:  # it was no hole
            self.lag_s = max(swing.late_s, LAG_FORGOTTEN * self.lag_s)
        if hangs:
            self.hanging, self.over = self.hanging | {leg}, over if over.moves else self.over
