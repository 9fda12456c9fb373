"""The hexapod in LeRobot: its protocol with the abstract methods alone, and the commands of the released LeRobot."""

import json
import os
import re
import runpy
import sys
import tarfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.client import Client
from schemas.robot import LEGS
from schemas.words import Kind
from tests.support import lerobot_protocol
from tests.support.camera_server import CameraServer
from tests.support.command import run_program
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, last_angles
from tests.support.waiting import wait_until

EXAMPLE: Final = Path(__file__).parents[2] / "examples" / "lerobot"
LEROBOT: Final = Path(sys.prefix) / "lerobot" / "bin"
"""`make .venv/lerobot`."""
OFFLINE: Final = {**os.environ, "HF_HUB_OFFLINE": "1"}
ACTION: Final = {"forward.vel": 0.05, "left.vel": 0.0, "turn.vel": 0.1, "gait": 1.0}

gateway = gateway_fixture({**patient(4000), "telemetry": {"frames": True}})
watcher = client_fixture("watcher")


@pytest.fixture
def plug_in() -> dict[str, Any]:
    """Return the example's names, with LeRobot's abstract classes alone."""
    lerobot_protocol.install()
    found = runpy.run_path(str(EXAMPLE / "lerobot_robot_hexapod.py"), run_name="lerobot_robot_hexapod")
    for name in [each for each in sys.modules if each.partition(".")[0] == "lerobot"]:
        del sys.modules[name]
    return found


@pytest.fixture
def made(gateway: Gateway, plug_in: dict[str, Any]) -> Iterator[Any]:
    """Return a function that makes a robot of these options."""
    robots = []

    def make(**options: Any) -> Any:
        config = plug_in["HexapodConfig"](endpoint=gateway.endpoint, **options)
        robots.append(plug_in["Hexapod"](config))
        return robots[-1]

    yield make
    for robot in robots:
        robot.disconnect()


def test_velocities_walk_and_the_end_sits_and_releases(made: Any, watcher: Client) -> None:
    robot = made()
    assert not robot.is_connected
    robot.connect()
    assert watcher.state().lease.holder == "lerobot"
    assert not any(leg.running for leg in watcher.state().legs), "connecting moves nothing"
    seen = robot.get_observation()
    assert seen.keys() == robot.observation_features.keys()
    assert all(isinstance(value, float) for value in seen.values())

    def walks() -> bool:
        assert robot.send_action(ACTION) == ACTION
        return bool(robot.get_observation()["joint_11.target"] != seen["joint_11.target"])

    wait_until(walks, "a step", 30)
    robot.disconnect()
    assert not robot.is_connected
    assert watcher.state().lease.holder is None
    assert not any(leg.running for leg in watcher.state().legs)


def test_angles_are_sent_no_faster_than_asked(made: Any, watcher: Client) -> None:
    robot = made(actions="angles", max_deg_s=50.0)
    written = frames(watcher)
    robot.connect()
    assert robot.send_action(dict.fromkeys(robot.action_features, 90.0)) == dict.fromkeys(robot.action_features, 90.0)
    sent = robot.send_action(dict.fromkeys(robot.action_features, 120.0))
    assert all(90 < angle <= 95 for angle in sent.values()), "0.1 s at the most"
    wait_until(lambda: len(last_angles(written.all)) == 18, "all servos", 20)
    robot.disconnect()
    wait_until(lambda: not any(leg.running for leg in watcher.state().legs), "rest", 20)


def test_an_emergency_stop_ends_the_episode_with_a_sentence(made: Any, watcher: Client) -> None:
    robot = made()
    robot.connect()
    told = events(watcher)
    robot.send_action(ACTION)
    wait_until(lambda: all(watcher.state().leg(leg).running for leg in LEGS), "standing", 30)
    watcher.estop("anna")
    told.wait(lambda event: event.kind == Kind.ESTOP_ENGAGED)
    with pytest.raises(ConnectionError, match="the episode has ended: the emergency stop was engaged by anna"):
        wait_until(lambda: robot.send_action(ACTION) is None, "its end", 20)
    robot.disconnect()
    watcher.reset()


def test_a_teleoperator_drives_steadily_without_keys(plug_in: dict[str, Any]) -> None:
    config = plug_in["HexapodTeleopConfig"](keys=False, forward_m_s=0.05, left_m_s=0.0, turn_rad_s=0.1, gait=1)
    teleop = plug_in["HexapodTeleop"](config)
    teleop.connect()
    assert teleop.get_action() == ACTION
    assert teleop.action_features.keys() == ACTION.keys()


def test_a_camera_keeps_its_url(plug_in: dict[str, Any]) -> None:
    """LeRobot's own OpenCV camera reads a Path, which has one slash."""
    camera = type(
        "Camera", (), {"index_or_path": Path("http://robot.local:8080/stream"), "height": 480, "width": 640}
    )()
    plug_in["HexapodConfig"](cameras={"front": camera})
    assert camera.index_or_path == "http://robot.local:8080/stream"


# ---- LeRobot itself


def lerobot(command: str, gateway: Gateway, folder: Path | None, *options: str, code: int = 0) -> str:
    """Run a command of LeRobot's, with its dataset in `folder`. Return what it wrote to stderr."""
    robot = ["--robot.type=hexapod", f"--robot.endpoint={gateway.endpoint}"]
    if folder is not None:
        robot += ["--dataset.repo_id=me/ride", f"--dataset.root={folder / 'ride'}", "--play_sounds=false"]
    return run_program(LEROBOT / command, *robot, *options, env=OFFLINE, code=code).stderr


RECORD: Final = (
    "--teleop.type=hexapod", "--teleop.keys=false", "--dataset.single_task=walk", "--dataset.num_episodes=1",
    "--dataset.fps=30", "--dataset.push_to_hub=false",
)  # fmt: skip
SECONDS: Final = ("--fps=30", "--teleop_time_s=5")
LOAD: Final = """
import json, sys
from lerobot.datasets import LeRobotDataset
from lerobot.robots import Robot
from lerobot.teleoperators import Teleoperator
ride = LeRobotDataset("me/ride", root=sys.argv[1])
found = {"frames": ride.num_frames, "names": ride.features["action"]["names"]}
last = ride[len(ride) - 1]
found["action"], found["picture"] = last["action"].tolist(), [*last["observation.images.front"].shape]
found["robot"], found["teleoperator"] = (sorted(each.__abstractmethods__) for each in (Robot, Teleoperator))
print(json.dumps(found))
"""


@pytest.mark.nightly
@pytest.mark.skipif(not LEROBOT.exists(), reason="make .venv/lerobot")
def test_the_released_lerobot_records_loads_and_replays(gateway: Gateway, watcher: Client, tmp_path: Path) -> None:
    with CameraServer() as camera:
        front = f"{{front: {{type: opencv, index_or_path: '{camera.url}', width: 32, height: 24, fps: 30}}}}"
        seen = f"--robot.cameras={front}", "--dataset.video=false"
        lerobot("lerobot-record", gateway, tmp_path, *RECORD, *seen, "--dataset.episode_time_s=10")
    loads = run_program(LEROBOT / "python", "-c", LOAD, tmp_path / "ride", env=OFFLINE, timeout=300)
    loaded = json.loads(loads.stdout.splitlines()[-1])
    assert loaded["names"] == [*ACTION]
    assert loaded["action"] == pytest.approx([0.06, 0.04, 0.2, 0.0])
    assert loaded["frames"] > 30
    assert loaded["picture"] == [3, 24, 32]
    assert tuple(loaded["robot"]) == lerobot_protocol.ROBOT
    assert tuple(loaded["teleoperator"]) == lerobot_protocol.TELEOPERATOR
    written = frames(watcher)
    lerobot("lerobot-replay", gateway, tmp_path, "--dataset.episode=0")
    lerobot("lerobot-teleoperate", gateway, None, "--teleop.type=hexapod", "--teleop.keys=false", *SECONDS)
    assert len(last_angles(written.all)) == 18
    assert watcher.state().lease.holder is None


OWN_TESTS: Final = "tests/test_control_robot.py"
"""Of LeRobot's released source: its wheel has no tests, and all others of its robots are about one device's parts."""
STAND_INS: Final = {
    "__init__.py": "",
    "mocks/mock_robot.py": """
import os
from functools import partial
from lerobot_robot_hexapod import HexapodConfig
MockRobotConfig = partial(HexapodConfig, endpoint=os.environ["ENDPOINT"])
""",
    "mocks/mock_teleop.py": """
from functools import partial
from lerobot_robot_hexapod import HexapodTeleopConfig
MockTeleopConfig = partial(HexapodTeleopConfig, keys=False)
""",
    "fixtures/constants.py": "DUMMY_REPO_ID = 'me/ride'",
}
"""What these tests import, which the source lacks: here the hexapod instead of a robot that does nothing."""


@pytest.mark.nightly
@pytest.mark.skipif(not LEROBOT.exists(), reason="make .venv/lerobot")
def test_lerobots_own_tests_of_a_robot_pass_with_the_hexapod(gateway: Gateway, tmp_path: Path) -> None:
    """They calibrate, teleoperate, record, resume and replay."""
    for name, text in STAND_INS.items():
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / name).write_text(text)
    (source,) = LEROBOT.parent.glob("source/lerobot-*.tar.gz")
    with tarfile.open(source) as archive:
        (member,) = (each for each in archive if each.name.partition("/")[2] == OWN_TESTS)
        (tmp_path / OWN_TESTS).write_bytes(archive.extractfile(member).read())  # type: ignore[union-attr]
    command = (LEROBOT / "python", "-m", "pytest", "-p", "no:cacheprovider", OWN_TESTS)
    done = run_program(*command, cwd=tmp_path, env={**OFFLINE, "ENDPOINT": gateway.endpoint})
    assert re.search(r"=== \d+ passed in .*===$", done.stdout, re.M), done.stdout


@pytest.mark.nightly
@pytest.mark.skipif(not LEROBOT.exists(), reason="make .venv/lerobot")
def test_an_emergency_stop_ends_lerobots_recording(gateway: Gateway, watcher: Client, tmp_path: Path) -> None:
    told = events(watcher)
    with ThreadPoolExecutor(1) as thread:
        options = (*RECORD, "--dataset.episode_time_s=60")
        recording = thread.submit(lerobot, "lerobot-record", gateway, tmp_path, *options, code=1)
        wait_until(lambda: watcher.state().leg(1).running, "its start", 300)
        watcher.estop()
        ended = recording.result()
    told.wait(lambda event: event.kind == Kind.ESTOP_ENGAGED)
    assert re.search(r"^ConnectionError: the episode has ended: .*emergency stop was engaged by watcher", ended, re.M)
    watcher.reset()
