"""Each gait goes where it was sent, in three worlds, and how fast. Physics is the judge (docs/walking.md)."""

import math
from typing import Any, Final

import numpy as np
import pytest

from gateway.geometry import MAX_SPEED_DEG_S, load
from gateway.model.servo import NO_LOAD_DEG_S
from gateway.people.physics.assumed import USUAL, Assumed
from gateway.people.walking.engine import Engine
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.motion import STILL, Posture, Velocity, travelled
from gateway.people.walking.robot import Range, Robot
from schemas.robot import SERVO_IDS
from tests.walking.physics import SPEEDS_M_S, TICK_S, heading_rad, stood_up, walk

OFF: Final = 0.10
"""Of the distance that was commanded."""
ASIDE: Final = 0.05
"""Of the way."""
TURNED_DEG: Final = 5.0
TILT_DEG: Final = 5.0
SCRAPED_M: Final = 0.010
SHORT_M: Final = 0.006
"""A way of a few centimetres says little of what a robot drifts on a long one: standing up shifts it by as much."""
SETTLES_S: Final = 0.2
"""Behind a part of a course: the servos have followed by then."""
_ARM_M: Final = 0.3
"""A turn on the spot carries the feet along a circle of about this radius: its way, for what it drifts."""
_CARRIES: Final = 0.15
"""Of the robot's weight: a foot that carries less is being put down or lifted, and is not in its stance."""
_GEOMETRY: Final = load()


class Walker:
    """A simulated robot of these assumptions that has stood up, and what becomes of it."""

    def __init__(self, gait: str, assumed: Assumed) -> None:
        self.engine = Engine(Robot(_GEOMETRY), gait)
        self.world = stood_up(self.engine, assumed)
        self._carries_n = _CARRIES * 9.81 * float(sum(self.world.model.body_mass))
        self._stood: dict[int, Any] = {}
        self._heading_rad = self._tilt_deg = self._scraped_m = 0.0

    @property
    def height_m(self) -> float:
        return self.world.body().position_m[2]

    def walk(self, name: str, velocity: Velocity, seconds: float) -> list[str]:
        """Walk at a velocity, and stand. Return what was wrong."""
        (begin_x_m, begin_y_m, _), begin_rad = self.world.body().position_m, self._heading_rad
        self._tilt_deg = self._scraped_m = 0.0
        for _ in range(round(seconds / TICK_S)):
            self._tick(velocity)
        self.engine.stand()
        self._until(Posture.STANDING)
        x_m, y_m, _ = self.world.body().position_m
        east_m, north_m = x_m - begin_x_m, y_m - begin_y_m
        cosine, sine = math.cos(begin_rad), math.sin(begin_rad)
        ahead_m, left_m = cosine * east_m + sine * north_m, cosine * north_m - sine * east_m
        turned_deg = math.degrees(self._heading_rad - begin_rad)
        return [f"{name}: {fault}" for fault in self._faults(velocity, seconds, ahead_m, left_m, turned_deg)]

    def sit(self) -> None:
        self.engine.sit()
        self._until(Posture.SITTING)

    def _faults(
        self, velocity: Velocity, seconds: float, ahead_m: float, left_m: float, turned_deg: float
    ) -> list[str]:
        x_m, y_m, turned_rad = travelled(velocity, seconds)
        wanted_m = math.hypot(x_m, y_m)
        speed_m_s = max(math.hypot(velocity.forward_m_s, velocity.left_m_s), abs(velocity.turn_rad_s) * _ARM_M)
        went_m, aside_m = 0.0, math.hypot(ahead_m, left_m)
        if wanted_m:
            went_m = (ahead_m * x_m + left_m * y_m) / wanted_m
            aside_m = abs(ahead_m * y_m - left_m * x_m) / wanted_m
        wrong_deg = turned_deg - math.degrees(turned_rad)
        found = {
            f"went {went_m:.3f} m of {wanted_m:.3f}": abs(went_m - wanted_m) > max(OFF * wanted_m, SHORT_M),
            f"{1000 * aside_m:.0f} mm aside": aside_m > max(ASIDE * seconds * speed_m_s, SHORT_M),
            f"heading off by {wrong_deg:+.1f} degrees": abs(wrong_deg) > TURNED_DEG,
            f"leaned by {self._tilt_deg:.1f} degrees": self._tilt_deg > TILT_DEG,
            f"a foot scraped by {1000 * self._scraped_m:.1f} mm": self._scraped_m > SCRAPED_M,
        }
        return [what for what, is_off in found.items() if is_off]

    def _until(self, posture: Posture) -> None:
        while self.engine.posture is not posture:
            self._tick(STILL)
        for _ in range(round(SETTLES_S / TICK_S)):
            self._tick(STILL)

    def _tick(self, wanted: Velocity) -> None:
        walk(self.world, self.engine, wanted)
        self._heading_rad += math.remainder(heading_rad(self.world) - self._heading_rad, math.tau)
        self._tilt_deg = max(self._tilt_deg, self.world.body().tilt_deg)
        for foot, newtons in zip(self.world.feet, self.world.feet_n(), strict=True):
            at = self.world.data.geom_xpos[foot][:2]
            if newtons > self._carries_n:
                begun = self._stood.setdefault(foot, at.copy())
                self._scraped_m = max(self._scraped_m, float(np.linalg.norm(at - begun)))
            else:
                self._stood.pop(foot, None)


WORLDS: Final = {
    "as assumed": USUAL,
    "the weakest robot": USUAL._replace(mass_kg=1.3 * USUAL.mass_kg, torque_nm=0.7 * USUAL.torque_nm),
    "the most slippery floor": USUAL._replace(friction=0.7 * USUAL.friction),
}
TURNS_RAD_S: Final = {"tripod": 0.25, "ripple": 0.12, "wave": 0.06}
STANDS_M: Final = 0.154
LIES_M: Final = 0.07


@pytest.mark.parametrize("gait", sorted(GAITS))
@pytest.mark.parametrize("world", WORLDS)
def test_it_goes_where_it_was_sent(gait: str, world: str) -> None:
    walker = Walker(gait, WORLDS[world])
    assert walker.height_m == pytest.approx(STANDS_M, abs=0.015)
    faults = walker.walk("forward", Velocity(SPEEDS_M_S[gait]), 4.0)
    faults += walker.walk("left", Velocity(0, SPEEDS_M_S[gait]), 3.5)
    faults += walker.walk("turn", Velocity(0, 0, TURNS_RAD_S[gait]), 3.5)
    assert not faults
    walker.sit()
    assert walker.height_m < LIES_M


def test_the_judge_notices_a_robot_that_slips() -> None:
    """On ice it does not go where it was sent; so the figures are those of the world, not of the walker."""
    assert Walker("tripod", USUAL._replace(friction=0.01)).walk("forward", Velocity(0.08), 4.0)


# ---- at the Elkapod's limits: reached, or the walk names the servo that is too slow

LIMITS: Final = {"tripod": Velocity(0.15, 0, 0.5), "ripple": Velocity(0.10, 0, 0.25), "wave": Velocity(0.05, 0, 0.1)}
"""The Elkapod's own, forward and turning at the same time."""
_BEGINS_S: Final = 3.0
_LASTS_S: Final = 12.0
_LOOK_S: Final = 0.1


def reached(gait: str, servo_deg_s: float) -> tuple[float, float, set[str]]:
    """Return which parts of LIMITS, forward and turn, are reached with servos of this speed, and what limits them.

    The parts are means of twelve seconds on a flat floor; the limits are in the walk's words.
    """
    wanted = LIMITS[gait]
    robot = Robot(_GEOMETRY, {servo_id: Range(max_speed_deg_s=servo_deg_s) for servo_id in SERVO_IDS})
    engine = Engine(robot, gait)
    world = stood_up(engine)
    walk(world, engine, wanted, _BEGINS_S)
    ahead_m = turned_rad = 0.0
    limits = set[str]()
    for _ in range(round(_LASTS_S / _LOOK_S)):
        (x_m, y_m, _), heading = world.body().position_m, heading_rad(world)
        walk(world, engine, wanted, _LOOK_S)
        turned = math.remainder(heading_rad(world) - heading, math.tau)
        (to_x_m, to_y_m, _), middle = world.body().position_m, heading + turned / 2
        ahead_m += (to_x_m - x_m) * math.cos(middle) + (to_y_m - y_m) * math.sin(middle)
        turned_rad += turned
        limits |= {engine.limit} - {""}
    return ahead_m / _LASTS_S / wanted.forward_m_s, turned_rad / _LASTS_S / wanted.turn_rad_s, limits


@pytest.mark.parametrize("gait", LIMITS)
@pytest.mark.parametrize(
    ("servo_deg_s", "forward", "turn"), [(NO_LOAD_DEG_S, 0.92, 0.97), (MAX_SPEED_DEG_S, 0.85, 0.85)]
)
def test_forward_and_turn_are_reached_at_the_same_time_or_the_servo_that_is_too_slow_is_named(
    gait: str, servo_deg_s: float, forward: float, turn: float
) -> None:
    """Within a servo's own speed, and with the usual limit."""
    ahead, turned, limits = reached(gait, servo_deg_s)
    assert ahead > forward
    assert turned > turn
    assert servo_deg_s == NO_LOAD_DEG_S or any("the speed of servo" in limit for limit in limits)
