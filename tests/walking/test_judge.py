"""The short form of `make walk`: each gait through a real gateway, and its frames in three worlds."""

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import pytest

from gateway.geometry import load
from gateway.people.walking import GAITS, Velocity
from tests.walking.__main__ import SPEEDS_M_S, TURNS_RAD_S
from tests.walking.judge import OFF, judge, stopped_at, table
from tests.walking.physics import FALLEN_DEG, SUNK_M, VARIATIONS, Assumed, World, setpoints, went
from tests.walking.recorded import Leg, Recording, record, record_live

WORLDS: Final = (VARIATIONS[0], Assumed(mass=1.3, force=0.7), Assumed(friction=0.7))
"""As assumed, the weakest robot, and the most slippery floor."""
PHASES: Final = 8
STALLED_S: Final = 0.15
"""A recording by the clock with a longer silence shows the machine, and not the walk."""
_TRIES: Final = 5


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


@pytest.mark.parametrize("gait", sorted(GAITS))
def test_a_stop_in_any_phase_of_a_stride_lets_it_sink_and_never_topple(
    recordings: dict[str, Recording], gait: str
) -> None:
    """All servos slack, as after an emergency stop, at eight times within a stride."""
    recording = recordings[gait]
    begin_s = recording.parts[0].begin_s + 1.0
    for eighth in range(PHASES):
        track = stopped_at(recording, begin_s + eighth * GAITS[gait].period_s / PHASES, WORLDS[0])
        assert max(pose.tilt_deg for pose in track.poses) < FALLEN_DEG
        assert track.poses[-1].height_m < SUNK_M


def test_a_walk_by_the_clock_goes_as_far_as_its_own_odometry(tmp_path: Path) -> None:
    """`Client.walk` in real time; what its machine stalls for is not held against the walk."""
    stalls = []
    for number in range(_TRIES):
        folder = tmp_path / str(number)
        folder.mkdir()
        recording = record_live(folder, "tripod", Leg("forward", Velocity(SPEEDS_M_S["tripod"]), 3.0))
        if recording.stalled_s <= STALLED_S:
            break
        stalls.append(f"{1000 * recording.stalled_s:.0f} ms")
    else:
        pytest.fail(f"this machine is too busy to judge: each recording stalled, for {', '.join(stalls)}")
    [walked] = recording.parts
    track = World().run(setpoints(recording.records, load()))
    ahead_m, left_m, turned_deg = went(track.at(walked.begin_s), track.at(walked.end_s))
    by_itself_m = walked.end.x_m - walked.begin.x_m
    assert by_itself_m > SPEEDS_M_S["tripod"] * 2.0
    assert ahead_m == pytest.approx(by_itself_m, rel=OFF)
    assert math.hypot(left_m, turned_deg) < 5
    assert not track.fell


def test_a_recording_is_the_same_however_busy_the_machine_is(tmp_path: Path, recordings: dict[str, Recording]) -> None:
    """Else a judge's verdict would be one on the machine: in lockstep a frame has its tick's time."""
    again = record(tmp_path, "tripod", course("tripod")[:1])
    end_ns = round(again.parts[0].end_s * 1e9)

    def until_it_stands(recording: Recording) -> list[tuple[int, str]]:
        return [(each.monotonic_ns, each.bytes) for each in recording.records if each.monotonic_ns < end_ns]

    assert until_it_stands(again) == until_it_stands(recordings["tripod"])  # which was made beside two others


def test_the_judge_notices_a_robot_that_slips(recordings: dict[str, Recording]) -> None:
    """On ice it does not go where it was sent; so the figures are those of the world, not of the walker."""
    assert judge(recordings["tripod"], Assumed(friction=0.01)).faults
