"""A walk of some metres, or a turn of some radians: the next velocity. Pure: time is an argument.

`next` is called at each tick. If the calls stop, the robot stands, as after any other velocity.
"""

import math
from typing import Final

from gateway.errors import WalkError
from gateway.people.walking.motion import Odometry, Velocity, WalkState
from gateway.people.walking.tempo import SLEW_M_S2, SLEW_RAD_S2
from gateway.people.walking.ways import LONGEST_S

MOST_M: Final = 20.0
"""Four minutes of walking. More is probably millimetres."""
MOST_RAD: Final = 4 * math.pi
"""Two turns. More is probably degrees."""
_M_S: Final = 0.08
_RAD_S: Final = 0.25
"""The speeds that tests/walking judges for a tripod gait; the engine scales them down for shorter strides."""
_GENTLY: Final = 0.5
"""Of the engine's own deceleration: a velocity has an effect a tick or two after it was computed."""
_NEAR: Final = 0.0005
"""Metres or radians at which it has arrived."""


class Distance:
    """A distance or a turn, which begins with the first call of `next`."""

    def __init__(self, amount: float, *, turns: bool) -> None:
        """Metres, forward above 0; `turns`: radians, counter-clockwise above 0. Raises WalkError."""
        name, most, meant = ("radians", MOST_RAD, "degrees") if turns else ("metres", MOST_M, "millimetres")
        if isinstance(amount, bool) or not isinstance(amount, int | float) or not math.isfinite(amount):
            raise WalkError(f"{name} is {amount!r}; a distance is a finite number")
        if abs(amount) > most:
            raise WalkError(f"{name} is {amount:g}, and at most {most:.4g} are taken; are these {meant}?")
        self._amount = float(amount)
        self._turns = turns
        self._begin: Odometry | None = None
        self._nearest, self._nearer_s = math.inf, 0.0

    def next(self, state: WalkState, now_s: float) -> Velocity | None:
        """The velocity now; None: it has arrived. Raises WalkError if the robot comes no nearer."""
        if self._begin is None:
            self._begin, self._nearer_s = state.odometry, now_s
        left = math.copysign(1.0, self._amount) * (self._amount - self._gone(state.odometry))
        if left < _NEAR:
            return None
        if left < self._nearest - _NEAR:
            self._nearest, self._nearer_s = left, now_s
        if now_s - self._nearer_s > LONGEST_S:
            raise WalkError(f"it has come no nearer for {LONGEST_S:g} s: {state.limit or f'it is {state.posture}'}")
        cruise, slows = (_RAD_S, SLEW_RAD_S2) if self._turns else (_M_S, SLEW_M_S2)
        speed = math.copysign(min(cruise, math.sqrt(2 * _GENTLY * slows * left)), self._amount)
        return Velocity(turn_rad_s=speed) if self._turns else Velocity(forward_m_s=speed)

    def _gone(self, odometry: Odometry) -> float:
        """The metres or radians so far."""
        begin = self._begin or odometry
        if self._turns:
            return odometry.heading_rad - begin.heading_rad
        x_m, y_m = odometry.x_m - begin.x_m, odometry.y_m - begin.y_m
        return x_m * math.cos(begin.heading_rad) + y_m * math.sin(begin.heading_rad)
