"""What other people's programs read of a recording: rosbags, mcap-ros2-support and Rerun; none needs a screen."""

import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from gateway.people.recorder.drawing import DRAWN, FRAMES, JOINT_COMMANDS, LOG
from tests.unit.people.test_recordings import drawn_in, positions, recorded

RERUN: Final = Path(sys.executable).with_name("rerun")


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ride") / "ride.mcap"
    recorded(path, 600)
    return path


def test_rosbags_reads_it_as_a_ros_2_bag(ride: Path) -> None:
    with AnyReader([ride]) as reader:
        types = {each.topic: each.msgtype for each in reader.connections if each.topic in DRAWN}
        assert types == {topic: kind.TYPE for topic, kind in DRAWN.items()}
        wanted = [each for each in reader.connections if each.topic == JOINT_COMMANDS]
        found: list[Any] = [
            reader.deserialize(raw, each.msgtype) for each, _, raw in reader.messages(connections=wanted)
        ]
    commanded = [(each.name, each.position.tolist()) for each in found]
    ours = [positions(each) for each in drawn_in(ride, JOINT_COMMANDS)]
    assert repr(commanded) == repr([(list(each), list(each.values())) for each in ours]), "as text, since NaN != NaN"
    assert commanded


def test_mcap_ros2_decodes_every_message(ride: Path) -> None:
    with ride.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {channel.topic: ros for _, channel, _, ros in reader.iter_decoded_messages(topics=list(DRAWN))}
    assert found.keys() == DRAWN.keys()
    assert {each.child_frame_id for each in found[FRAMES].transforms} >= {"base", "leg_6_foot"}
    assert found[LOG].name == "hexapod-gateway"


def test_rerun_finds_no_fault_and_converts_it(ride: Path, tmp_path: Path) -> None:
    checked = subprocess.run([RERUN, "mcap", "check", ride], capture_output=True, text=True, check=False)
    lines = [line for line in checked.stdout.splitlines() if any(f" {topic} " in line for topic in DRAWN)]
    assert len(lines) == len(DRAWN), checked.stdout + checked.stderr
    assert all(line.startswith("ok") for line in lines), checked.stdout
    into = tmp_path / "ride.rrd"
    subprocess.run([RERUN, "mcap", "convert", ride, "-o", into], capture_output=True, check=True)
    assert into.stat().st_size > 100_000
