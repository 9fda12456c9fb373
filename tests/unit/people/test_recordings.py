"""Recordings: what is in the file, that viewers understand its schemas, and what is left of one that was cut off."""

import errno
import json
import math
import random
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from typing import Any, Final

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from pydantic import BaseModel, TypeAdapter

from gateway.errors import ConfigError
from gateway.geometry import joint_name, load, urdf
from gateway.model.frames import OneServo, Op, ServoOp, stop_leg
from gateway.people.recordings import REPORTS, Drawing, Recording, read
from gateway.people.recordings.contents import contents, cut
from gateway.people.recordings.drawing import (
    DESCRIPTION,
    DIAGNOSTICS,
    DRAWN,
    FRAMES,
    JOINT_COMMANDS,
    JOINT_STATES,
    LOG,
    SERVOS_OFF,
    SIM_JOINT_STATES,
)
from gateway.people.recordings.plain_schema import plain_schema, without_nulls
from gateway.people.recordings.writing import about
from gateway.people.ros2.cdr import definition
from gateway.people.ros2.messages import JointState, Marker, MarkerArray, Message, String, TFMessage, TransformStamped
from gateway.people.tools.recordings import info
from schemas import keys
from schemas.command import SERVO_COMMAND, LegCommand, LegsCommand, ResetCommand
from schemas.robot import SERVO_IDS
from schemas.telemetry import Ack, GatewayState
from tests.support.mcap_file import checked
from tests.support.measuring import MEASURED
from tests.support.ros2_bytes import decode

pytestmark = pytest.mark.full

WIRE: Final = Path(__file__).parents[2] / "data" / "wire"
START_NS: Final = 1_700_000_000_000_000_000
PERIOD_NS: Final = 3_333_333
MODELS: Final[tuple[type[BaseModel], ...]] = (*REPORTS.values(), Ack, LegCommand, LegsCommand, ResetCommand)
NAMES: Final = {
    keys.STATE: "1.0/state",
    keys.EVENT: "1.0/event",
    keys.FRAME: "1.0/frame",
    keys.CALIBRATION: "1.1/calibration",
}
BODY: Final[dict[str, Any]] = {
    "time": "2026-11-22T16:34:33.129026Z",
    "position_m": [0.3, 0.1, 0.05],
    "orientation_xyzw": [1.0, 0.0, 0.0, 0.0],
    "velocity_m_s": [0.0, 0.0, -0.2],
    "upright": False,
    "feet": [True, False, False, False, False, False],
    "servos": {str(servo_id): {"angle_deg": 45.0, "torque_nm": 0.5} for servo_id in SERVO_IDS},
    "terrain": "flat",
    "real_time_factor": 1.0,
}
"""On its back."""


def reports(count: int) -> Iterator[tuple[str, dict[str, Any], int]]:
    """Recorded payloads of all keys, in turn."""
    wires = {
        key: [json.loads(line) for line in (WIRE / f"{name}.jsonl").read_text().splitlines()]
        for key, name in NAMES.items()
    }
    wires[keys.SIM_BODY] = [BODY]
    wires[keys.TELEMETRY] = [MEASURED.model_dump(mode="json")]
    for number in range(count):
        others = {0: keys.STATE, 10: keys.CALIBRATION, 15: keys.EVENT, 20: keys.SIM_BODY, 25: keys.TELEMETRY}
        key = others.get(number % 30, keys.FRAME)
        yield key, wires[key][number % len(wires[key])], START_NS + number * PERIOD_NS


def recorded(path: Path, count: int = 600) -> Recording:
    recording = Recording(path, time_ns=START_NS)
    for topic, report, time_ns in reports(count):
        recording.add_report(topic, report, time_ns)
    return recording


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ride.mcap"


def test_mcaps_own_reader_finds_every_report_and_each_message_is_as_its_schema_says(path: Path) -> None:
    recorded(path).close()
    found: dict[str, list[Any]] = {}
    for topic, content in checked(path):
        found.setdefault(topic, []).append(content)
    assert found.keys() == REPORTS.keys() | DRAWN.keys()
    for key in REPORTS:
        assert found[key] == [without_nulls(report) for topic, report, _ in reports(600) if topic == key]
    assert len(found[LOG]) == len(found[keys.EVENT])
    with path.open("rb") as file:
        reader = make_reader(file)
        attached = {each.name: each.data.decode() for each in reader.iter_attachments()}
        assert attached.keys() == {"robot.urdf", *(f"{key}.schema.json" for key in REPORTS)}
        assert attached["robot.urdf"] == urdf(load())
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(map(len, found.values()))
    drawn = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
    assert drawn == {kind.TYPE: definition(kind) for kind in DRAWN.values()}


def drawn_in(path: Path, topic: str) -> list[Message]:
    """What viewers draw of it, in a whole file."""
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages(topics=[topic], log_time_order=False)
        return [decode(DRAWN[topic], message.data) for _, _, message in messages]


def positions(message: Message) -> dict[str, float]:
    """Joint → radians."""
    assert isinstance(message, JointState)
    return dict(zip(message.name, message.position, strict=True))


def commands(drawn: dict[str, Message]) -> dict[str, float]:
    """Of the joints whose servos run: joint → radians."""
    return {name: at_rad for name, at_rad in positions(drawn[JOINT_COMMANDS]).items() if not math.isnan(at_rad)}


def marks(drawn: dict[str, Message]) -> tuple[Marker, ...]:
    found = drawn[SERVOS_OFF]
    assert isinstance(found, MarkerArray)
    return found.markers


def frames_of(message: Message) -> dict[str, TransformStamped]:
    """By the name of what is there."""
    assert isinstance(message, TFMessage)
    return {each.child_frame_id: each for each in message.transforms}


def test_a_simulated_body_is_drawn_where_it_is_beside_what_was_commanded() -> None:
    drawing = Drawing(load())
    for topic, report, time_ns in reports(20):
        list(drawing.take(topic, report, time_ns))
    before = frames_of(dict(drawing.picture(START_NS))[FRAMES])
    drawn = dict(drawing.take(keys.SIM_BODY, BODY, START_NS + 10**9))
    frames = frames_of(drawn[FRAMES])
    base = frames["base"].transform
    assert frames["base"].header.frame_id == "world"
    assert (base.translation.x, base.translation.y, base.translation.z) == (0.3, 0.1, 0.05)
    assert (base.rotation.x, base.rotation.y, base.rotation.z, base.rotation.w) == (1.0, 0.0, 0.0, 0.0)
    true_rad = load().joint_rad(12, 45.0)
    assert positions(drawn[SIM_JOINT_STATES])["joint_12"] == true_rad
    assert positions(drawn[JOINT_STATES])["joint_12"] != true_rad
    assert frames["commanded/leg_1_femur"].transform == before["leg_1_femur"].transform
    assert frames["leg_1_femur"].transform != before["leg_1_femur"].transform
    later = dict(drawing.picture(START_NS + 3 * 10**9))
    assert list(frames_of(later[FRAMES])) == list(before), "its process has ended: what was commanded is all"
    assert SIM_JOINT_STATES not in later


def test_what_the_gateway_publishes_is_what_is_recorded() -> None:
    assert set(keys.PUBLISHED) == REPORTS.keys(), "a new key wants its model in REPORTS"


def assert_viewers_read(schema: dict[str, Any], place: str) -> None:
    """The rules of Lichtblick's and Foxglove's parser: anything else hides the channel."""
    assert schema.get("type") == "object", place
    for name, member in schema["properties"].items():
        here = f"{place}.{name}"
        if "oneOf" in member:
            assert all(isinstance(each["const"], int) for each in member["oneOf"]), here
            continue
        assert member["type"] in {"boolean", "string", "number", "integer", "object", "array"}, here
        inner = member["items"] if member["type"] == "array" else member
        assert inner["type"] in {"boolean", "string", "number", "integer", "object"}, here
        if inner["type"] == "object":
            assert_viewers_read(inner, here)
    assert not {"$ref", "$defs", "anyOf", "allOf"} & schema.keys(), place


@pytest.mark.parametrize(
    "schema",
    [
        *(plain_schema(TypeAdapter(model), model.__name__) for model in MODELS),
        plain_schema(SERVO_COMMAND, "ServoCommand"),
    ],
    ids=lambda schema: schema["title"],
)
def test_viewers_read_every_schema(schema: dict[str, Any]) -> None:
    assert_viewers_read(schema, schema["title"])


def test_a_topic_has_one_channel_since_viewers_show_no_other(path: Path) -> None:
    with Recording(path, time_ns=START_NS, reports={}) as recording:
        recording.declare(keys.FRAME, "FrameRecord", {"type": "object"})
        with pytest.raises(ValueError, match="hexapod/frame has a channel already"):
            recording.declare(keys.FRAME, "FrameInBox", {"type": "object"})


def test_a_choice_that_viewers_cannot_be_told_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="choice"):
        plain_schema(TypeAdapter(dict[str, int] | str), "X")


def test_joints_are_drawn_where_they_are_commanded_to_be() -> None:
    geometry = load()
    drawing = Drawing(geometry)
    frame = {"bytes": "0e0129010900 29".replace(" ", ""), "cause": "command"}  # no frame at all
    assert positions(dict(drawing.take(keys.FRAME, frame, START_NS))[JOINT_STATES]) == {}
    start = {"bytes": "0602200 15a00".replace(" ", "")}  # servo 32, Start, 90 degrees
    drawn = dict(drawing.take(keys.FRAME, start, START_NS + 10**9))
    assert positions(drawn[JOINT_STATES]) == commands(drawn) == {"joint_32": 0.0}
    assert list(positions(drawn[JOINT_COMMANDS])) == list(map(joint_name, SERVO_IDS)), "each has its place in a plot"
    assert len(frames_of(drawn[FRAMES])) == 24
    stop = {"bytes": "060220020000"}
    after = dict(drawing.take(keys.FRAME, stop, START_NS + 2 * 10**9))
    assert positions(after[JOINT_STATES]) == {"joint_32": 0.0}, "a stopped servo stays where it was sent"
    assert commands(after) == {}, "a gap in its plot"


def test_many_frames_are_few_pictures_and_each_a_command() -> None:
    drawing = Drawing(load())
    start = {"bytes": "060220015a00"}
    drawn = [dict(drawing.take(keys.FRAME, start, START_NS + number * PERIOD_NS)) for number in range(300)]
    assert 15 <= sum(FRAMES in each for each in drawn) <= 20
    assert all(commands(each) == {"joint_32": 0.0} for each in drawn), "at the frames' rate"


def test_what_is_off_is_marked_at_once_and_again_each_second() -> None:
    drawing = Drawing(load())
    clear, *unknown = marks(dict(drawing.picture(START_NS)))
    assert (clear.action, unknown) == (Marker.DELETEALL, [])
    stop = {"bytes": stop_leg(3).to_bytes().hex()}
    _, *found = marks(dict(drawing.take(keys.FRAME, stop, START_NS + 1)))
    spheres = {mark.id: mark.header.frame_id for mark in found if mark.type == Marker.SPHERE}
    assert spheres == {31: "leg_3_coxa", 32: "leg_3_femur", 33: "leg_3_tibia"}
    assert [mark.text for mark in found if mark.type == Marker.TEXT_VIEW_FACING] == ["leg 3 off"]
    assert all(mark.frame_locked and mark.color.a > 0 for mark in found), "they go where the leg goes"
    assert SERVOS_OFF not in dict(drawing.take(keys.FRAME, stop, START_NS + 2)), "nothing has changed"
    start = {"bytes": "060220015a00"}  # servo 32
    _, *found = marks(dict(drawing.take(keys.FRAME, start, START_NS + 3)))
    assert [mark.id for mark in found] == [31, 33], "one of them runs, so the leg is not off"
    assert SERVOS_OFF in dict(drawing.take(keys.FRAME, start, START_NS + 10**9 + 3))


def test_another_mode_is_in_the_diagnostics_at_once() -> None:
    drawing = Drawing(load())
    state = next(report for topic, report, _ in reports(1) if topic == keys.STATE)
    assert DIAGNOSTICS in dict(drawing.take(keys.STATE, state, START_NS))
    assert DIAGNOSTICS not in dict(drawing.take(keys.STATE, state, START_NS + 10**8))
    assert DIAGNOSTICS in dict(drawing.take(keys.STATE, {**state, "mode": "estopped"}, START_NS + 2 * 10**8))


def test_a_state_marks_what_it_states_to_be_off() -> None:
    drawing = Drawing(load())
    state = next(report for topic, report, _ in reports(1) if topic == keys.STATE)
    off = [servo["id"] for leg in state["legs"] for servo in leg["servos"] if not servo["running"]]
    found = marks(dict(drawing.take(keys.STATE, state, START_NS)))
    assert [mark.id for mark in found if mark.type == Marker.SPHERE and mark.action != Marker.DELETEALL] == off
    assert 0 < len(off) < len(SERVO_IDS)


def test_frames_of_a_calibrated_robot_are_not_taken_for_its_users_angles() -> None:
    drawing = Drawing(load())
    state = next(report for topic, report, _ in reports(1) if topic == keys.STATE)
    list(drawing.take(keys.STATE, {**state, "calibration": {"revision": 3}}, START_NS))
    assert not list(drawing.take(keys.FRAME, {"bytes": "060220015a00"}, START_NS + 10**9))
    told = {"revision": 3, "servos": {"32": {"trim_deg": 10}}, "landing": {}}
    assert not list(drawing.take(keys.CALIBRATION, told, START_NS + 2 * 10**9))
    its_own_110 = {"bytes": OneServo(32, ServoOp(Op.SET, 110_00)).to_bytes().hex()}
    drawn = dict(drawing.take(keys.FRAME, its_own_110, START_NS + 3 * 10**9))
    assert positions(drawn[JOINT_STATES])["joint_32"] == load().joint_rad(32, 100.0)


# ---- what is in it, and a piece of it


def test_its_contents_are_said_for_people_and_programs(path: Path) -> None:
    with recorded(path) as recording:
        recording.describe(about(GatewayState.model_validate(next(report for topic, report, _ in reports(1)))))
    found = contents(path)
    assert found.messages[keys.FRAME] == sum(topic == keys.FRAME for topic, _, _ in reports(600))
    assert found.end_s - found.begin_s == pytest.approx(599 * PERIOD_NS / 1e9, abs=1e-3)
    assert found.about["watchdog"]["timeout_ms"] > 0
    assert found.as_json()["messages"] == found.messages
    assert any("hexapod/frame" in line for line in found.lines())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert contents(path).lines()[-1].startswith("It ends in the middle, or is being written; `recordings cut`")


def test_a_strangers_names_do_not_control_the_terminal_and_what_is_empty_is_not_damaged(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Recording(path, time_ns=START_NS, reports={}) as recording:
        recording.declare("\x1b[2J", "X", {"type": "object"})
        recording.add("\x1b[2J", {}, START_NS)
    info(path)
    assert r"1  \x1b[2J" in capsys.readouterr().out
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(ConfigError, match=r"has no message$"):
        contents(path)


def test_a_piece_has_its_seconds_and_what_holds_for_all_of_it(path: Path) -> None:
    recorded(path, 1800).close()
    piece = path.with_name("piece.mcap")
    count = cut(path, piece, from_s=2.0, to_s=3.0)
    found, whole = contents(piece), contents(path)
    assert count + 2 == sum(found.messages.values())
    assert found.begin_s == pytest.approx(whole.begin_s + 2.0, abs=1e-3)
    assert found.end_s == pytest.approx(whole.begin_s + 3.0, abs=0.01)
    assert drawn_in(piece, DESCRIPTION) == [String(urdf(load()))]
    with pytest.raises(ConfigError, match="exists; name another file"):
        cut(path, piece, from_s=0, to_s=1)
    assert contents(piece) == found
    with pytest.raises(ConfigError, match="has no message in that piece of it"):
        cut(path, path.with_name("none.mcap"), from_s=100, to_s=200)
    assert not path.with_name("none.mcap").exists()


# ---- cut off


def test_of_a_killed_writer_all_but_the_newest_messages_are_there(path: Path) -> None:
    recording = recorded(path, 2000)  # and nobody closes it
    found = [message for message in read(path) if message.topic in REPORTS]
    assert len(found) >= 2000 - 151, "those of half a second"
    expected = [(topic, without_nulls(report), time_ns) for topic, report, time_ns in reports(2000)]
    assert [(each.topic, each.content, each.time_ns) for each in found] == expected[: len(found)]
    recording.close()


@pytest.mark.parametrize("time", ["1969-12-31T23:59:59Z", "9999-12-31T23:59:59Z", "", None], ids=repr)
def test_a_time_that_no_file_can_tell_is_left_out(path: Path, time: str | None) -> None:
    """Somebody else's report, or a gateway's without a clock: the rest is recorded as ever."""
    event = {"time": time, "kind": "started", "source": None, "key": None, "reason": None, "detail": ""}
    with Recording(path, time_ns=START_NS) as recording:
        recording.add_report(keys.EVENT, event, START_NS)
    ((told, published),) = [(each.time_ns, each.publish_ns) for each in read(path) if each.topic == keys.EVENT]
    assert told == published == START_NS


def test_a_quiet_robots_messages_do_not_wait_for_a_full_chunk(path: Path) -> None:
    recording = Recording(path, time_ns=START_NS)
    event = next(report for topic, report, _ in reports(30) if topic == keys.EVENT)
    for second in range(1, 4):
        recording.add_report(keys.EVENT, event, START_NS + second * 10**9)
    assert sum(1 for message in read(path) if message.topic == keys.EVENT) >= 2
    recording.close()


def test_of_a_file_cut_off_anywhere_a_whole_one_is_made_with_all_that_it_still_has(path: Path) -> None:
    with Recording(path, time_ns=START_NS):
        begun = path.stat().st_size
    path.unlink()
    recorded(path).close()
    data = path.read_bytes()
    chance = random.Random(1)  # noqa: S311
    into = path.with_name("whole.mcap")
    for end in (*(chance.randrange(begun + 30_000, len(data)) for _ in range(20)), len(data) - 1, len(data) - 8):
        path.write_bytes(data[:end])
        expected = list(read(path))
        assert cut(path, into, from_s=0, to_s=1e9) > len(expected)
        with into.open("rb") as file:
            own = [
                (channel.topic, json.loads(message.data))
                for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
                if channel.topic not in DRAWN
            ]
        assert own == [(message.topic, message.content) for message in expected]
        into.unlink()


@pytest.mark.parametrize("content", [b"", b"x" * 100, b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\0" * 50])
def test_what_is_no_recording_is_reported(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"ride\.mcap: (is no MCAP|no message|has no message)"):
        contents(path)


def test_a_disk_that_is_full_from_the_beginning_is_left_without_an_empty_file(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full(FileIO):
        def write(self, _data: object, /) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gateway.people.recordings.writing.FileIO", Full)
    with pytest.raises(OSError, match="No space"):
        Recording(path, time_ns=START_NS)
    assert not path.exists()


def test_no_second_program_writes_a_file_that_is_being_written(path: Path) -> None:
    with recorded(path) as recording:
        with pytest.raises(FileExistsError):
            Recording(path, time_ns=START_NS)
        with pytest.raises(ConfigError, match="another program"):
            Recording(path, overwrite=True, time_ns=START_NS)
        recording.add_report(*next(reports(1)))
    assert len(list(read(path))) > 600
