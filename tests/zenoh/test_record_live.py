"""`record` against a real gateway: a viewer's side of `--live`, and the file, also after the recorder was killed."""

import itertools
import json
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from websockets import Subprotocol
from websockets.sync.client import ClientConnection, connect

from gateway.client import Client
from gateway.geometry import load
from gateway.people.recorder.drawing import DRAWN, FRAMES, JOINT_COMMANDS, JOINT_STATES, LOG, SIM_JOINT_STATES
from gateway.people.recorder.record import REPORTS, Recording, ReportQueue, flush_period_s
from schemas.event import FrameRecord
from schemas.keys import EVENT, FRAME, SIM_BODY, STATE, TELEMETRY
from tests.support.camera_server import CameraServer, jpeg
from tests.support.child import Child
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import Heard, events, frames, states
from tests.support.published import MEASURED
from tests.support.recordings import about, checked, whole
from tests.support.ros2_messages import decode
from tests.support.waiting import meanwhile
from tests.unit.people.test_recordings import drawn_in, positions, recorded

PATIENCE_S = 30
EXAMPLES: Final = Path(__file__).parents[2] / "examples"


# On a busy machine a setpoint may come late, but hardly by two seconds.
gateway = gateway_fixture({"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 2000}})


def address_of(child: Child) -> str:
    found = re.search(r"ws://127\.0\.0\.1:\d+", child.wait_for_output("ws://"))
    assert found is not None
    return found[0]


def text(viewer: ClientConnection, op: str) -> dict[str, Any]:
    while True:
        message = viewer.recv(PATIENCE_S)
        if isinstance(message, str) and (found := json.loads(message))["op"] == op:
            assert isinstance(found, dict)
            return found


def test_a_viewer_sees_all_channels_and_publishes_nothing(gateway: Gateway) -> None:
    command = [*COMMAND, "record", "--live", "--port", "0", "--connect", gateway.endpoint]
    with closing(Child(command, os.environ)) as child, gateway.client() as robot:
        # The server answers no closing handshake while it sends, and nobody here waits for that.
        with connect(address_of(child), subprotocols=[Subprotocol("foxglove.sdk.v1")], close_timeout=0.1) as viewer:
            assert text(viewer, "serverInfo")["capabilities"] == []
            channels: dict[int, Any] = {}
            while len(channels) < len(REPORTS) + len(DRAWN):
                channels |= {channel["id"]: channel for channel in text(viewer, "advertise")["channels"]}
            assert {channel["topic"] for channel in channels.values()} == REPORTS.keys() | DRAWN.keys()

            viewer.send(json.dumps({"op": "advertise", "channels": [
                {"id": 1, "topic": "hexapod/legs/cmd", "encoding": "json", "schemaName": "LegsCommand"}
            ]}))  # fmt: skip
            assert "clientPublish" in text(viewer, "status")["message"]
            viewer.send(b"\x01\x01\x00\x00\x00" + json.dumps({"legs": {"1": {}}}).encode())
            assert text(viewer, "status")["level"] == 2, "an error"

            subscriptions = [{"id": each, "channelId": each} for each in channels]
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
            seen: set[str] = set()
            wanted = (REPORTS.keys() | DRAWN.keys()) - {SIM_BODY, SIM_JOINT_STATES}
            begun_s, moved_s = time.monotonic(), -math.inf
            while not seen >= wanted:
                assert time.monotonic() - begun_s < 6 * PATIENCE_S, wanted - seen
                message = viewer.recv(PATIENCE_S)
                if isinstance(message, str):
                    continue
                channel = channels[int.from_bytes(message[1:5], "little")]
                if (kind := DRAWN.get(channel["topic"])) is None:
                    assert channel["schema"] == ""
                    REPORTS[channel["topic"]].model_validate_json(message[13:])
                else:
                    assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
                    decode(kind, message[13:])
                # Again: a server that is not read in time leaves messages out.
                if channel["topic"] == STATE and time.monotonic() - moved_s > 1:
                    moved_s = time.monotonic()
                    assert robot.start_leg(1, 90, 90, 90).accepted  # something to see
                    robot.stop()
                    assert not robot.set_leg(1, 90, 90, 90, check=False).accepted
                    assert robot.calibrate(landing={11: 45}).accepted
                    robot.session.put(TELEMETRY, MEASURED.model_dump_json())  # in the gateway's place
                seen.add(channel["topic"])
            assert robot.state().commands.rejected > 0
            assert robot.state().mode == "idle"

        taken = gateway.run("record", "--live", "--port", address_of(child).rpartition(":")[2])
        assert taken.returncode == 5, str(taken)
        child.send_signal(signal.SIGINT)
        assert child.wait() == 0, str(child)


# ---- the file

KILLS: Final = int(os.environ.get("RECORD_KILLS", "3"))
"""50 in the long form."""
HZ: Final = 50

robot = client_fixture("a gait")


@contextmanager
def walking(robot: Client) -> Iterator[None]:
    """Move six legs at 50 Hz meanwhile."""
    step = itertools.count()
    with (
        robot.stream(HZ) as stream,
        meanwhile(lambda: stream.set(dict.fromkeys(range(1, 7), (90 + next(step) % 20, 45, 120)))),
    ):
        yield


@contextmanager
def recording(gateway: Gateway, path: Path, *options: str) -> Iterator[Child]:
    with gateway.begin("record", str(path), *options) as child:
        child.wait_for_output("recording into", timeout_s=20)
        yield child


def test_all_that_the_gateway_publishes_is_in_the_file_and_as_the_files_own_schemas_say(
    gateway: Gateway, robot: Client, tmp_path: Path
) -> None:
    path = tmp_path / "ride.mcap"
    heard, told = Heard(robot, FRAME, FrameRecord), events(robot)
    with recording(gateway, path, "--csv") as child:
        with walking(robot):
            heard.wait(lambda _: len(heard.all) > 300)
        assert not robot.set_leg(1, 90, 90, 90, check=False).accepted
        told.wait(lambda event: event.kind == "command_rejected")
        later = states(robot)  # half a second of them: until then the recorder has heard the event as well
        later.wait(lambda _: len(later.all) > 5)
        newest = heard.all[-1]
        heard.wait(lambda record: record.cause == "repeat")
        # Once the recorder has this event, it has what was said before it.
        child.send_signal(signal.SIGINT)
        assert child.wait() == 0, str(child)
    assert f"{path}: " in child.stdout
    assert "publishes no frames" not in child.stderr
    found: dict[str, list[Any]] = {}
    for topic, content in checked(path):
        found.setdefault(topic, []).append(content)
    expected = [json.loads(record.model_dump_json()) for record in heard.all]
    in_file = found[FRAME]
    assert in_file == expected[expected.index(in_file[0]) :][: len(in_file)]
    assert json.loads(newest.model_dump_json()) in in_file
    assert found[STATE]
    assert [event["reason"] for event in found[EVENT] if event["kind"] == "command_rejected"] == ["servo_stopped"]
    assert len(found[FRAMES][-1].transforms) == 25
    assert len(found[JOINT_STATES][-1].name) == 18
    assert found[LOG]
    assert about(path)["watchdog"]["timeout_ms"] == 2000, "whose recording it is"
    rows = path.with_suffix(".csv").read_text().splitlines()
    assert len(rows) == 1 + len(found[STATE]) + len(found[FRAME])
    assert any(row.count(",45.0,") == 6 for row in rows), "all six legs ran"

    again = gateway.run("record", str(path))
    assert again.returncode == 2
    assert "exists" in again.stderr


def test_a_cameras_pictures_are_in_the_file_and_its_trouble_is_printed(gateway: Gateway, tmp_path: Path) -> None:
    path, made = tmp_path / "ride.mcap", tmp_path / "ride.rrd"
    with CameraServer() as front, CameraServer() as back:
        back.answer = lambda handler: handler.send_error(404)
        cameras = ("--camera", f"front={front.url}", "--camera", f"back={back.url}")
        done = gateway.run("record", str(path), "--for", "3", *cameras)
    assert done.returncode == 0, str(done)
    assert "The camera back answers with HTTP status 404." in done.stderr
    with AnyReader([path]) as reader:
        shown = [each for each in reader.connections if each.topic == "/camera/front"]
        read: list[Any] = [reader.deserialize(raw, each.msgtype) for each, _, raw in reader.messages(connections=shown)]
        begun_ns, ended_ns = reader.start_time, reader.end_time
        stamps = [time_ns for _, time_ns, _ in reader.messages(connections=shown)]
    pictures = [each.data.tobytes() for each in read]
    assert pictures == sorted(set(pictures)), "each once, in turn"
    assert f" {len(pictures)} pictures, " in done.stdout
    assert set(pictures) <= {jpeg(number) for number in range(1000)}
    assert all(begun_ns <= each <= ended_ns for each in stamps)
    example = EXAMPLES / "rerun_view.py"
    subprocess.run([sys.executable, example, path, "--save", made], capture_output=True, check=True)
    found = subprocess.run([RERUN, "rrd", "print", made], capture_output=True, text=True, check=True).stdout
    assert "/camera/front - data columns" in found
    again = gateway.run("record", str(path), "--camera", "nowhere")
    assert again.returncode == 2
    assert "--camera is no URL" in again.stderr


HOURS: Final = float(os.environ.get("RECORD_HOURS", "1"))
"""Three, with `-o faulthandler_timeout=0`, for docs/recordings.md."""
SEEN_S: Final = 20.0
"""So long a robot is seen walking; that is recorded again and again. A chunk has four seconds, so none gets smaller."""


@pytest.mark.nightly
@pytest.mark.alone
@pytest.mark.parametrize("with_frames", [False, True], ids=["without frames", "with frames"])
def test_hours_of_walking_need_as_much_memory_as_ten_minutes(
    with_frames: bool, gateway: Gateway, robot: Client, tmp_path: Path
) -> None:
    """In virtual time. Prints the size of an hour."""
    with gateway.client() as observer, robot.walk() as walk:
        reports = ReportQueue(observer.states, observer.state().physics)
        walk.go(0.05)
        reports.subscribe(observer.session)
        begun_ns = time.monotonic_ns()
        while time.monotonic_ns() - begun_ns < SEEN_S * 1e9:
            walk.go(0.05)
        reports.end()
    received = [each for each in iter(lambda: reports.get(0.0), None) if with_frames or each[0] != FRAME]
    seen_ns = received[-1][2] - received[0][2]
    recording, path = Recording(load()), tmp_path / "ride.mcap"
    recording.open_file(path, {}, received[0][2])
    flushed_ns, memory, sizes = 0, dict[float, int](), dict[float, int]()
    for turn in range(round(HOURS * 3600e9 / seen_ns)):
        for key, report, time_ns in received:
            now_ns = turn * seen_ns + time_ns - received[0][2]
            recording.add(key, report, now_ns + received[0][2])
            if now_ns >= flushed_ns:
                flushed_ns = now_ns + round(1e9 * flush_period_s(now_ns / 1e9))
                recording.flush()
        memory[now_ns / 3600e9], sizes[now_ns / 3600e9] = resident_bytes(), path.stat().st_size
    recording.close()
    early = max(size for at_h, size in memory.items() if at_h <= HOURS / 6)
    grown = max(memory.values()) - early
    per_hour_mb = (max(sizes.values()) - min(sizes.values())) / (max(sizes) - min(sizes)) / 1e6
    print(f"\n{len(received) / seen_ns * 1e9:.0f} reports a second: {per_hour_mb:.0f} MB an hour; ", end="")
    print(f"memory after {HOURS / 6:g} h {early / 1e6:.0f} MB, {grown / 1e6:.1f} MB more in {HOURS:g} h", end="")
    assert grown < 1e6 * HOURS


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.full
@pytest.mark.alone
def test_a_killed_recorder_leaves_all_but_the_newest(gateway: Gateway, robot: Client, tmp_path: Path) -> None:
    written = frames(robot)
    chance = random.Random()  # noqa: S311
    killed_ns: dict[Path, int] = {}
    with walking(robot):
        for number in range(KILLS):
            path = tmp_path / f"ride-{number}.mcap"
            with recording(gateway, path) as child:
                written.wait(lambda _: True, count=len(written.all) + chance.randrange(200, 600), timeout_s=20)
                child.kill()
                killed_ns[path] = time.monotonic_ns()
    expected = [json.loads(record.model_dump_json()) for record in written.all]
    for path, end_ns in killed_ns.items():
        found = [content for topic, content in whole(path) if topic == FRAME]
        first = expected.index(found[0])
        assert found == expected[first : first + len(found)], "none is missing between the first and the last"
        lost_s = (end_ns - found[-1]["monotonic_ns"]) / 1e9
        assert lost_s < 1, "a tenth of these seconds, and what a busy machine adds"


# ---- what other people's programs read: rosbags, mcap-ros2-support and Rerun; none needs a screen


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


def test_rerun_finds_no_fault(ride: Path) -> None:
    """What it shows of one: test_examples.py."""
    checked = subprocess.run([RERUN, "mcap", "check", ride], capture_output=True, text=True, check=False)
    lines = [line for line in checked.stdout.splitlines() if any(f" {topic} " in line for topic in DRAWN)]
    assert len(lines) == len(DRAWN), checked.stdout + checked.stderr
    assert all(line.startswith("ok") for line in lines), checked.stdout
