"""The short form of `make walk`: each gait in three worlds."""

from functools import cache
from typing import Final

import pytest

from gateway.people.walking import GAITS, Velocity
from tests.walking.__main__ import SPEEDS_M_S, TURNS_RAD_S
from tests.walking.judge import judge, table
from tests.walking.physics import VARIATIONS, Assumed
from tests.walking.recorded import Leg, Recording, record

WORLDS: Final = (VARIATIONS[0], Assumed(mass=1.3, force=0.7), Assumed(friction=0.7))
"""As assumed, the weakest robot, and the most slippery floor."""
STANDS_M: Final = 0.154
LIES_M: Final = 0.07


def course(gait: str) -> list[Leg]:
    speed, turn = SPEEDS_M_S[gait], TURNS_RAD_S[gait]
    return [
        Leg("forward", Velocity(speed), 4.0),
        Leg("left", Velocity(0, speed), 3.5),
        Leg("turn", Velocity(0, 0, turn), 3.5),
    ]


@cache
def recorded(gait: str) -> Recording:
    return record(gait, course(gait))


@pytest.mark.parametrize("gait", sorted(GAITS))
@pytest.mark.parametrize("world", WORLDS, ids=str)
def test_it_goes_where_it_was_sent(gait: str, world: Assumed) -> None:
    verdict = judge(recorded(gait), world)
    assert not verdict.faults, table(verdict.results)
    assert verdict.track.at(recorded(gait).parts[0].begin_s).height_m == pytest.approx(STANDS_M, abs=0.015)
    assert verdict.track.poses[-1].height_m < LIES_M


def test_the_judge_notices_a_robot_that_slips() -> None:
    """On ice it does not go where it was sent; so the figures are those of the world, not of the walker."""
    assert judge(recorded("tripod"), Assumed(friction=0.01)).faults
