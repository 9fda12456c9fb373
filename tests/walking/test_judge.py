"""The short form of `make walk`: each gait through a real gateway, and its frames in three worlds."""

from concurrent.futures import ThreadPoolExecutor
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


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """All gaits at the same time, each through a gateway of its own."""
    folders = {gait: tmp_path_factory.mktemp(gait) for gait in GAITS}
    with ThreadPoolExecutor() as threads:
        found = threads.map(lambda gait: record(folders[gait], gait, course(gait)), GAITS)
    return {recording.gait: recording for recording in found}


@pytest.mark.parametrize("gait", sorted(GAITS))
@pytest.mark.parametrize("world", WORLDS, ids=str)
def test_it_goes_where_it_was_sent(recordings: dict[str, Recording], gait: str, world: Assumed) -> None:
    verdict = judge(recordings[gait], world)
    assert not verdict.faults, table(verdict.results)
    assert verdict.track.at(recordings[gait].parts[0].begin_s).height_m == pytest.approx(STANDS_M, abs=0.015)
    assert verdict.track.poses[-1].height_m < LIES_M


def test_the_judge_notices_a_robot_that_slips(recordings: dict[str, Recording]) -> None:
    """On ice it does not go where it was sent; so the figures are those of the world, not of the walker."""
    assert judge(recordings["tripod"], Assumed(friction=0.01)).faults
