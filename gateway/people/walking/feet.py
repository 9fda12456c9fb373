"""A walk between two ticks: its feet in the air, and how they come down, as expected or as felt. Pure."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple, Self

from gateway.geometry.kinematics import Vector
from gateway.people.walking import balance
from gateway.people.walking.motion import ORIGIN, STILL, Odometry, Velocity
from gateway.people.walking.transitions import ALMOST, Figure

_PRESSED_M: Final = 0.004
"""A foot that carries is commanded at least this far below the ground: servos give way."""


class Swing(NamedTuple):
    """A foot in the air: where it left the ground, which moves on below it, and how far it is, 0 to 1."""

    left: Vector
    part: float = 0.0
    free: bool = False
    """Whether the foot was felt in the air: only then a contact is news."""
    met: bool = False
    """Whether the foot was felt on the ground after that."""
    late_s: float = 0.0
    """For how long the foot has been where the ground was expected."""
    trail: tuple[tuple[float, float], ...] = ()
    """Its latest ticks, the newest first: how long ago (seconds), and the foot's height (metres)."""

    def met_now(self, touches: bool | None) -> bool:
        """Return whether the foot is felt on the ground after it was in the air."""
        return self.free and touches is True


@dataclass(slots=True)
class State(Figure):
    """All that a tick changes. A tick works on a copy, since one that is too fast is undone. Values are immutable."""

    swings: dict[int, Swing] = field(default_factory=dict)
    velocity: Velocity = STILL
    tempo: float = 1.0
    """The present period of a stride, as a part of the gait's."""
    clock: float = 0.0
    """The time in strides."""
    odometry: Odometry = ORIGIN
    part: float = 0.0
    """The part of its first move that is done, 0 to 1."""
    rests: dict[int, Vector] = field(default_factory=dict)
    """By leg, where its foot rests if the body's lean put it further out than in the stance."""
    rises: dict[int, float] = field(default_factory=dict)
    """By leg, how far (metres) its foot went too deep because its contact was reported late."""
    waits_s: float = balance.LATE_S
    """How long a foot waits for its contact where the ground was expected."""
    lateness: balance.Lateness = balance.UNKNOWN_LATENESS
    paused_s: float = 0.0
    """How long (seconds) feet wait in a stride. Its stances last longer by this time."""
    hanging: frozenset[int] = frozenset()
    """Legs whose feet found no ground, when the walk went `over`."""
    over: Velocity = STILL
    brake_s: float = 0.0
    """Seconds until the velocity is 0, while it slows down."""

    def copy(self) -> Self:
        new = Figure.copy(self)
        new.swings, new.rests, new.rises = dict(self.swings), dict(self.rests), dict(self.rises)
        return new

    def lower(self, leg: int, swing: Swing, height_m: float, touches: bool | None, seconds: float) -> bool:
        """Take a foot in the air a tick further. Return whether it hangs: found no ground as far down as it may go.

        `height_m`: its height by the gait; `touches`: whether it is felt on the ground, None if unknown. The foot waits
        `waits_s` for its contact before it goes on down, and longer at the lowest point. A contact is reported as late
        as the sensors are: the ground is where the foot was at contact.
        """
        x, y, now_m = self.feet[leg]
        lag_s = self.lateness.median_s if self.lateness.median_s > balance.CERTAIN_S else 0.0
        before = (at_m for ago_s, at_m in swing.trail if ago_s >= lag_s - ALMOST)
        met_m = next(before, now_m) if lag_s else now_m
        if swing.met_now(touches) and (swing.late_s or (swing.part > 0.5 and met_m > balance.EARLY_M)):
            self.rises[leg] = max(0.0, met_m - now_m - _PRESSED_M)
            self._land(leg, swing, touches)
            return False
        trail = ((ago_s + seconds, at_m) for ago_s, at_m in swing.trail if ago_s < balance.LATE_S)
        self.swings[leg] = swing = swing._replace(
            free=swing.free or touches is False,
            met=swing.met or swing.met_now(touches),
            trail=() if touches is None else ((seconds, now_m), *trail),
        )
        if swing.part <= 1.0 - ALMOST:
            self.feet[leg] = x, y, height_m
        elif not swing.free or touches is not False:
            self.feet[leg] = x, y, now_m if swing.late_s else 0.0
            self._land(leg, swing, touches)
        elif swing.late_s > self.waits_s + balance.DEEPEST_M / balance.SINKS_M_S + balance.LATE_S:
            self.hanging |= {leg}
            self._land(leg, swing, touches)
            return True
        else:
            sunk_m = max(-balance.DEEPEST_M, now_m - balance.SINKS_M_S * seconds)
            self.feet[leg] = x, y, sunk_m if swing.late_s > self.waits_s else 0.0
            self.swings[leg] = swing._replace(late_s=swing.late_s + seconds)
        return False

    def _land(self, leg: int, swing: Swing, touches: bool | None) -> None:
        del self.swings[leg]
        if swing.met_now(touches) and swing.late_s <= balance.LATE_S:  # it was no hole
            self.waits_s = max(swing.late_s, balance.WAIT_FORGOTTEN * self.waits_s)

    def goes_over(self, velocity: Velocity) -> bool:
        """Return whether this velocity leads further over an edge. The way back is allowed."""
        return bool(self.hanging) and sum(a * b for a, b in zip(velocity, self.over, strict=True)) > 0

    def rise(self, seconds: float) -> None:
        """Raise feet that went too deep to the ground again."""
        for leg, left_m in list(self.rises.items()):
            (x, y, z), up_m = self.feet[leg], min(left_m, balance.SINKS_M_S * seconds)
            self.feet[leg] = x, y, z + up_m
            self.rises[leg] = left_m - up_m
            if left_m == up_m or leg in self.swings:
                del self.rises[leg]

    def pause(self, period_s: float, seconds: float) -> bool:
        """Count a wait of the stride for a foot. Return whether it waits now."""
        waits = any(swing.late_s for swing in self.swings.values())
        if waits or self.paused_s:
            self.paused_s += (seconds if waits else 0.0) - self.paused_s * min(1.0, seconds / period_s)
        return waits
