"""Each gait goes where it was sent, in three worlds. Physics is the judge (docs/walking.md)."""

from typing import Final

import pytest

from gateway.people.physics.assumed import Assumed
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.motion import Velocity
from tests.walking.judge import Part, Walker
from tests.walking.physics import SPEEDS_M_S

USUAL: Final = Assumed()
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
    faults = walker.walk(Part("forward", Velocity(SPEEDS_M_S[gait]), 4.0))
    faults += walker.walk(Part("left", Velocity(0, SPEEDS_M_S[gait]), 3.5))
    faults += walker.walk(Part("turn", Velocity(0, 0, TURNS_RAD_S[gait]), 3.5))
    assert not faults
    walker.sit()
    assert walker.height_m < LIES_M


def test_the_judge_notices_a_robot_that_slips() -> None:
    """On ice it does not go where it was sent; so the figures are those of the world, not of the walker."""
    assert Walker("tripod", USUAL._replace(friction=0.01)).walk(Part("forward", Velocity(0.08), 4.0))
