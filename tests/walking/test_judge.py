"""The short form of `make walk`: each gait through a real gateway, and its frames in three worlds."""

from concurrent.futures import ThreadPoolExecutor
from typing import Final

import pytest

from gateway.people.walking import GAITS, Velocity
from tests.walking.__main__ import SPEEDS_M_S, TURNS_RAD_S
from tests.walking.judge import judge, stopped_at, table
from tests.walking.physics import FALLEN_DEG, VARIATIONS, Assumed
from tests.walking.recorded import Leg, Recording, record

WORLDS: Final = (VARIATIONS[0], Assumed(mass=1.3, force=0.7), Assumed(friction=0.7))
"""As assumed, the weakest robot, and the most slippery floor."""


def course(gait: str) -> list[Leg]:
    speed, turn = SPEEDS_M_S[gait], TURNS_RAD_S[gait]
    return [
        Leg("forward", Velocity(speed), 6.0),
        Leg("left", Velocity(0, speed), 5.0),
        Leg("turn", Velocity(0, 0, turn), 4.0),
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


def test_it_stands_as_high_as_it_was_told_and_lies_down_gently(recordings: dict[str, Recording]) -> None:
    recording = recordings["tripod"]
    track = judge(recording, WORLDS[0]).track
    standing = track.at(recording.parts[0].begin_s)
    assert standing.height_m == pytest.approx(0.154, abs=0.015)
    assert track.poses[-1].height_m < 0.07
    assert track.poses[-1].tilt_deg < 3


def test_a_stop_in_any_phase_of_a_stride_lets_it_sink_and_never_topple(recordings: dict[str, Recording]) -> None:
    """All servos slack, as after an emergency stop, at eight times within a stride."""
    recording = recordings["tripod"]
    begin_s = recording.parts[0].begin_s + 2.0
    for eighth in range(8):
        track = stopped_at(recording, begin_s + eighth * GAITS["tripod"].period_s / 8, WORLDS[0])
        assert max(pose.tilt_deg for pose in track.poses) < FALLEN_DEG
        assert track.poses[-1].height_m < 0.08


def test_the_judge_notices_a_robot_that_slips(recordings: dict[str, Recording]) -> None:
    """On ice it does not go where it was sent; so the figures are those of the world, not of the walker."""
    assert judge(recordings["tripod"], Assumed(friction=0.05)).faults
