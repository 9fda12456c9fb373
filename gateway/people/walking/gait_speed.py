"""How fast a gait goes: its tempo, the slew of its velocity, and the servos' speed. Pure.

A stride that is too long for the feet's discs takes less time, with lower steps. A servo that is too slow slows all
motion down.
"""

import math
from typing import Final

from gateway.errors import WalkError
from gateway.geometry import MAX_SPEED_DEG_S
from gateway.model.frames import servo_ids_of
from gateway.people.numbers import plain
from gateway.people.walking.feet import State
from gateway.people.walking.gaits import Gait
from gateway.people.walking.motion import STILL, Odometry, Velocity, WalkState
from gateway.people.walking.robot import LIFT_M, Pose, Robot
from gateway.people.walking.transitions import ALMOST, CLIMB, LONGEST_S

SLEW_M_S2: Final = 0.25
"""The largest acceleration over the ground."""
SLEW_RAD_S2: Final = 1.2
"""The largest angular acceleration."""
_LEAST_TEMPO: Final = 0.37
"""The shortest period, as a part of the gait's. Usual servos lose more speed below it than strides gain."""
TEMPO_SPARE: Final = 0.93
"""The usable part of a disc: feet are lifted at ticks, up to one tick late."""
_TEMPO_S: Final = 1.0
"""A change of the tempo by 1 takes this long, since the change moves swinging feet."""
_QUICK_LIFT_M: Final = 0.020
"""How high feet are lifted at the least tempo."""
_QUICK_CLIMB: Final = 0.3
"""The part of a swing for that climb. Below 10 mm a foot, which may touch, moves straight up and down."""
SPEED_SPARE: Final = 0.95
"""The usable part of a servo's speed: the gateway measures from its own last frame, whose time varies a little."""
STOPS_WITHIN: Final = 0.35
"""The part of a stride after which a walk that ends has velocity 0: its last swing then ends within the stride."""
HALT_S: Final = 0.12
"""The time of a walk's end at once. Feet come down no faster than those of the quickest gait."""


def least(robot: Robot) -> float:
    """Return the least tempo of this robot, in parts of the gait's period. Slower servos bring it nearer to 1."""
    slowest_deg_s = min(each.max_speed_deg_s for each in robot.ranges.values())
    return min(1.0, _LEAST_TEMPO * max(1.0, MAX_SPEED_DEG_S / max(slowest_deg_s, ALMOST)))


def towards(now: float, stride: float, least_tempo: float, seconds: float) -> float:
    """Return the tempo after `seconds` on its way from `now` to the tempo for this stride.

    `stride`: as a part of its disc, at the gait's usual tempo.
    """
    wanted = max(least_tempo, min(1.0, TEMPO_SPARE / stride if stride else 1.0))
    most = seconds / _TEMPO_S
    return now + max(-most, min(most, wanted - now))


def at_tempo(gait: Gait, tempo: float) -> tuple[Gait, float, float]:
    """Return the gait at this tempo, the height of a lifted foot (m), and the part of a swing in which it climbs."""
    haste = (1.0 - tempo) / (1.0 - _LEAST_TEMPO)
    lift_m = LIFT_M + (_QUICK_LIFT_M - LIFT_M) * haste
    return gait._replace(period_s=gait.period_s * tempo), lift_m, CLIMB + (_QUICK_CLIMB - CLIMB) * haste


def fastest(robot: Robot, before: Pose, after: Pose, seconds: float) -> tuple[float, int]:
    """Return the speed nearest to its servo's limit, as a part of that limit, and the servo."""
    most = 0.0, 0
    for leg, angles in after.items():
        for servo_id, old, new in zip(servo_ids_of(leg), before[leg], angles, strict=True):
            allowed = robot.ranges[servo_id].max_speed_deg_s * SPEED_SPARE * seconds
            if old != new:
                most = max(most, (abs(new - old) / allowed if allowed else math.inf, servo_id))
    return most


def needs_s(change: Velocity) -> float:
    """Return how many seconds a change of velocity takes."""
    return max(math.hypot(change.forward_m_s, change.left_m_s) / SLEW_M_S2, abs(change.turn_rad_s) / SLEW_RAD_S2)


def slewed(state: State, target: Velocity, seconds: float, stops_s: float) -> Velocity:
    """Return the next velocity on the way to `target`. A walk that ends brakes evenly, within `stops_s`."""
    now = state.velocity
    if target.moves:
        state.brake_s = 0.0
        change = Velocity(*(b - a for a, b in zip(now, target, strict=True)))
        part = min(1.0, seconds / max(needs_s(change), ALMOST))
        return Velocity(*(a + part * b for a, b in zip(now, change, strict=True)))
    if not now.moves:
        return STILL
    state.brake_s = state.brake_s or stops_s
    left_s = state.brake_s - seconds
    part = max(0.0, left_s / state.brake_s)
    state.brake_s = max(0.0, left_s)
    return now.times(part) if part > ALMOST else STILL


def dropped(height_m: float, seconds: float) -> float:
    """Return a foot's height on its way straight down, which it reaches without a shock within `HALT_S`."""
    return max(0.0, math.sqrt(max(height_m, 0.0)) - math.sqrt(LIFT_M) * seconds / HALT_S) ** 2


MOST_M: Final = 20.0
"""Four minutes of walking. More is probably millimetres."""
MOST_RAD: Final = 4 * math.pi
"""Two turns. More is probably degrees."""
_M_S: Final = 0.08
_RAD_S: Final = 0.25
"""The speeds that tests/walking judges for a tripod gait; the engine scales them down for shorter strides."""
_GENTLY: Final = 0.5
"""The part of the engine's deceleration used: a velocity takes effect one or two ticks after its computation."""
_NEAR: Final = 0.0005
"""Metres or radians that count as arrived."""


class Distance:
    """A distance or a turn, which begins with the first call of `next`."""

    def __init__(self, amount: float, *, turns: bool) -> None:  # mutants accepted (Step): the first tick sets it
        """Metres, forward above 0; `turns`: radians, counter-clockwise above 0. Raises WalkError above 20 m or 4π."""
        name, most, meant = ("radians", MOST_RAD, "degrees") if turns else ("metres", MOST_M, "millimetres")
        value = plain(amount)
        if value is None or not math.isfinite(value):
            raise WalkError(f"{name} is {amount!r}; a distance is a finite number")
        if abs(value) > most:
            raise WalkError(f"{name} is {value:g}, and at most {most:.4g} are taken; are these {meant}?")
        self._amount = value
        self._turns = turns
        self._begin: Odometry | None = None
        self._nearest, self._nearer_s = math.inf, 0.0

    def next(self, state: WalkState, now_s: float) -> Velocity | None:
        """Return the velocity now; None at the goal. Raises WalkError if the robot comes no nearer for 30 s."""
        if self._begin is None:
            self._begin, self._nearer_s = state.odometry, now_s
        x_m, y_m, turned = (there - begun for there, begun in zip(state.odometry, self._begin, strict=True))
        heading = self._begin.heading_rad
        gone = turned if self._turns else x_m * math.cos(heading) + y_m * math.sin(heading)
        left = math.copysign(1.0, self._amount) * (self._amount - gone)
        if left < _NEAR:
            return None
        if left < self._nearest - _NEAR:
            self._nearest, self._nearer_s = left, now_s
        if now_s - self._nearer_s > LONGEST_S:
            raise WalkError(f"it has come no nearer for {LONGEST_S:g} s: {state.limit or f'it is {state.posture}'}")
        cruise, slows = (_RAD_S, SLEW_RAD_S2) if self._turns else (_M_S, SLEW_M_S2)
        speed = math.copysign(min(cruise, math.sqrt(2 * _GENTLY * slows * left)), self._amount)
        return Velocity(turn_rad_s=speed) if self._turns else Velocity(forward_m_s=speed)
