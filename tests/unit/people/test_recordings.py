"""Recordings: what is in the file, what viewers draw, and what docs/recordings.md says of both."""

import csv
import json
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from queue import Empty
from typing import Any, Final, cast

import pytest
import zenoh
from mcap.reader import make_reader

from gateway.geometry import load
from gateway.model.frames import stop_leg
from gateway.people.client.subscriptions import States
from gateway.people.recorder.drawing import DRAWN, FRAMES
from gateway.people.recorder.record import LOOK_S, MOST_WAITING, REPORTS, Recording, ReportQueue, flush_period_s
from gateway.people.ros2.messages import Message
from schemas import keys
from schemas.config import ConfigReport
from schemas.robot import SERVO_IDS
from schemas.words import Kind
from tests.support.published import MEASURED, event, payloads_of, state
from tests.support.recordings import checked, disk_that_takes
from tests.support.ros2_messages import decode

DOCS: Final = Path(__file__).parents[3] / "docs"
PAGE: Final = (DOCS / "recordings.md").read_text()
START_NS: Final = 1_700_000_000_000_000_000
PERIOD_NS: Final = 3_333_333
NAMES: Final = {
    keys.STATE: ("1.0", "state"),
    keys.EVENT: ("1.0", "event"),
    keys.FRAME: ("1.0", "frame"),
    keys.CALIBRATION: ("1.1", "calibration"),
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
    wires = {key: [json.loads(line) for line in payloads_of(version)[name]] for key, (version, name) in NAMES.items()}
    wires[keys.SIM_BODY] = [BODY]
    wires[keys.CONFIG] = [json.loads(ConfigReport.model_validate(dict(state())).model_dump_json())]
    wires[keys.TELEMETRY] = [MEASURED.model_dump(mode="json")]
    for number in range(count):
        others = {
            0: keys.STATE,
            10: keys.CALIBRATION,
            12: keys.CONFIG,
            15: keys.EVENT,
            20: keys.SIM_BODY,
            25: keys.TELEMETRY,
        }
        key = others.get(number % 30, keys.FRAME)
        yield key, wires[key][number % len(wires[key])], START_NS + number * PERIOD_NS


def begun(path: Path, count: int = 600) -> Recording:
    recording = Recording(load())
    recording.open_file(path, {"protocol": "1.0"}, START_NS)
    for topic, report, time_ns in reports(count):
        recording.add(topic, report, time_ns)
    return recording


def recorded(path: Path, count: int = 600) -> Path:
    begun(path, count).close()
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ride.mcap"


def drawn_in(path: Path, topic: str) -> list[Message]:
    """Return what viewers draw of a topic, in a whole file."""
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages(topics=[topic], log_time_order=False)
        return [decode(DRAWN[topic], message.data) for _, _, message in messages]


def positions(message: Message) -> dict[str, float]:
    """Return the radians of each joint."""
    return dict(zip(message.name, message.position, strict=True))


def test_each_message_has_the_time_at_which_it_was_received(path: Path) -> None:
    times_ns = [time_ns for _, _, time_ns in reports(60)]
    with recorded(path, 60).open("rb") as file:
        found = [(channel, message.log_time) for _, channel, message in make_reader(file).iter_messages()]
    assert [time_ns for channel, time_ns in found if channel.message_encoding == "json"] == times_ns
    assert {time_ns for channel, time_ns in found if channel.message_encoding != "json"} <= {START_NS, *times_ns}


def test_what_the_gateway_publishes_is_what_is_recorded() -> None:
    assert set(keys.PUBLISHED) == REPORTS.keys(), "a new key wants its model in REPORTS"


# ---- killed, full


def test_three_hours_have_few_chunks_and_a_killed_recorder_loses_a_tenth_and_four_seconds_at_most() -> None:
    """Each flush is a chunk, whose index stays in memory: 108 000 of them took 36 MB."""
    recorded_s, chunks = 0.0, 0
    while recorded_s < 3 * 3600:
        period_s = flush_period_s(recorded_s)
        assert period_s <= max(LOOK_S, min(recorded_s / 10, 4) + 1e-9)
        recorded_s, chunks = recorded_s + period_s, chunks + 1
    assert chunks < 2800


def test_a_disk_that_takes_no_more_is_noticed_with_the_next_flush(path: Path) -> None:
    recording = begun(path, 0)
    with disk_that_takes(path.stat().st_size + 1000):
        for topic, report, time_ns in reports(600):
            recording.add(topic, report, time_ns)
        with pytest.raises(OSError, match="I/O error"):
            recording.flush()


def test_a_file_that_exists_is_overwritten_on_request_only_and_who_writes_it_keeps_his_own(path: Path) -> None:
    first = begun(path)
    with pytest.raises(FileExistsError):
        Recording(load()).open_file(path, {}, START_NS)
    second = Recording(load())
    second.open_file(path, {}, START_NS, overwrite=True)
    for topic, report, time_ns in reports(30):
        second.add(topic, report, time_ns)
    first.close()
    second.close()
    assert sum(topic in REPORTS for topic, _ in checked(path)) == 30


# ---- the table


def test_a_table_has_the_commanded_angles_and_a_gap_where_a_servo_is_off(path: Path) -> None:
    recording = Recording(load())
    recording.open_table(path.with_suffix(".csv"))
    start = {"bytes": "060220015a00"}  # servo 32, Start, 90 degrees
    for number, report in enumerate((start, {"bytes": stop_leg(3).data.hex()})):
        recording.add(keys.FRAME, report, START_NS + number)
    recording.close()
    with path.with_suffix(".csv").open(newline="") as file:
        on, off = csv.DictReader(file)
    assert on.pop("time_s") == "1700000000.000000"
    assert {name: angle for name, angle in on.items() if angle} == {"servo_32_deg": "90.0"}
    assert list(on) == [f"servo_{servo_id}_deg" for servo_id in SERVO_IDS]
    assert set(off.values()) == {"", off["time_s"]}


NO_STATES: Final = States(cast(zenoh.Session, None))


def test_the_queue_leaves_out_what_is_no_report() -> None:
    queue = ReportQueue(NO_STATES)
    queue.put(keys.STATE, b"{}")
    queue.put(keys.EVENT, b"nonsense")
    queue.put(keys.EVENT, event(Kind.STOPPING, "it ends").model_dump_json().encode())
    for _ in range(2):
        with pytest.raises(Empty):
            queue.get(1.0)
    before_ns = queue.now_ns()
    found = queue.get(1.0)
    assert found is not None
    key, report, time_ns = found
    assert (key, report["detail"], queue.invalid) == (keys.EVENT, "it ends", 2)
    assert time_ns <= before_ns
    with pytest.raises(Empty):
        queue.get(0.0)
    queue.end()
    assert queue.get(1.0) is None


def test_a_queue_that_nobody_reads_does_not_grow() -> None:
    queue = ReportQueue(NO_STATES)
    for _ in range(MOST_WAITING + 3):
        queue.put(keys.EVENT, b"{}")
    assert queue.dropped == 3


# ---- the page


def test_the_pages_program_reads_a_recording(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded(path)
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(program.splitlines()) <= 22
    path.with_name("read.py").write_text(program)
    monkeypatch.setattr(sys, "argv", ["read.py", str(path)])
    runpy.run_path(str(path.with_name("read.py")))
    printed = capsys.readouterr().out
    assert "'watchdog': " in printed
    assert "11: 90.0" in printed


def test_the_viewers_layout_names_only_what_a_recording_has(path: Path) -> None:
    samples: dict[str, Any] = dict(checked(recorded(path)))
    layout = json.loads((DOCS / "viewers" / "lichtblick.json").read_text())
    panels: dict[str, dict[str, Any]] = layout["configById"]
    assert sorted(_panels(layout["layout"])) == sorted(panels)
    named = 0
    for panel in panels.values():
        topics = [*panel.get("topics", ()), *([panel["topicToRender"]] if "topicToRender" in panel else ())]
        assert set(topics) <= samples.keys()
        for series in panel.get("paths", ()):
            topic, *fields = re.split(r"\.|(?=\[)", series["value"])
            value = samples[topic]
            for field in fields:
                value = value[int(field[1:-1])] if field.startswith("[") else getattr(value, field)
            number = int(series["label"].removeprefix("joint_"))
            assert samples[topic].name[int(fields[-1][1:-1])] == f"joint_{number}", series
        named += len(topics) + len(panel.get("paths", ()))
    assert named == 10
    assert panels["3D!robot"]["followTf"] in {each.child_frame_id for each in samples[FRAMES].transforms}


def _panels(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else [*_panels(node["first"]), *_panels(node["second"])]


def test_the_pages_table_has_every_channel() -> None:
    table = PAGE.partition("## What a file contains")[2].partition("An exported incident")[0]
    named = re.findall(r"`(/?[a-z_/]+)`", "".join(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)))
    assert sorted(named) == sorted([*REPORTS, *DRAWN])
