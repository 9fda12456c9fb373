"""A calibration, from the payload on `hexapod/calibration/cmd` to the answer, the frames, the events and the state.

On the disk, what is written is read again, and what is broken in any way is an error.
"""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh import ZBytes

from gateway.errors import ConfigError
from gateway.host.directories import state_directory, state_to_read
from gateway.model.calibration import RobotCalibration, ServoMapping, calibration_of, changed, report_of
from gateway.model.frames import OneLeg, Op
from gateway.robot.core.rejections import Rejection
from gateway.robot.host.disk import DiskWriter, StateFolder
from gateway.robot.runtime.calibrations import (
    CALIBRATION_FILE,
    EARLIER_KEPT,
    MAX_CALIBRATION_BYTES,
    Calibrations,
    from_toml,
    load,
    previous,
    to_toml,
    write,
)
from gateway.robot.runtime.calibrations import read as read_file
from gateway.robot.runtime.request_answers import PAUSE_S
from schemas import calibration, keys
from schemas.ack import Ack
from schemas.calibration import CalibrationCommand
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.robot import SERVO_IDS
from schemas.words import Kind, Reason
from tests.support.robot import LEG_3, START, Robot, leg, started_and_quiet
from tests.unit.model.test_calibration import calibrations as any_calibration

OWN = {"servos": {"31": {"trim_deg": 7.5}, "32": {"inverted": True, "trim_deg": -10}, "33": {"max_deg": 140}}}
virtual_time = pytest.mark.virtual_time


def told(robot: Robot) -> calibration.Calibration:
    answers: list[bytes] = []
    robot.calibrations.answer(answers.append)
    return calibration.Calibration.model_validate_json(answers[0])


@virtual_time
async def test_the_calibration_is_published_at_a_change_and_at_a_question(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet()
    recorded: list[RobotCalibration] = []
    monkeypatch.setattr(robot.conductor.recorder, "calibration", recorded.append)
    robot.calibrations.publish()
    first = told(robot)
    assert (first.revision, len(first.servos), first.landing) == (0, 18, {})
    lease = robot.lease("acquire", "anna").lease
    assert [ack.reason for ack in robot.calibrate(OWN)] == [Reason.NOT_HOLDER]
    assert [ack.accepted for ack in robot.calibrate({**OWN, "landing": {"11": 45}, "lease": lease})] == [True]
    published = [report for key, report in robot.reports if key == keys.CALIBRATION]
    assert published == [first, told(robot)]
    assert [each.revision for each in recorded] == [0, 1]
    assert told(robot).servos["32"] == calibration.ServoCalibration(trim_deg=-10, inverted=True)
    assert told(robot).landing == {"11": 45}
    state = robot.states[-1].calibration
    assert (state.revision, state.fault, state.kept) == (1, None, False)


@virtual_time
async def test_while_the_disk_writes_stops_leave_and_what_comes_after_the_end_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk: list[Callable[[str | None], None]] = []
    monkeypatch.setattr(DiskWriter, "write", lambda _self, _write, then: disk.append(then))
    robot = Robot(state=StateFolder(tmp_path))
    robot.conductor.start()
    robot.conductor.reports.announce_start()
    await asyncio.sleep(1)
    answers = robot.calibrate(OWN)
    assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED
    assert robot.ask(keys.leg_command(1), START).accepted, "what it does not change goes on"
    await asyncio.sleep(0.3)
    assert robot.events(Kind.WATCHDOG_EXPIRED)
    assert robot.ask(keys.ESTOP).stop_frames == 6
    assert answers == []
    disk.pop()(None)
    assert (answers[0].accepted, told(robot).revision) == (True, 1)
    assert robot.ask(keys.RESET, {"estop": 1}).accepted
    answers = robot.calibrate(OWN)
    robot.conductor.shut_down()
    robot.conductor.close()
    disk.pop()(None)
    assert robot.calibrate(OWN) == answers == []
    assert told(robot).revision == 1


@virtual_time
async def test_the_folder_of_another_gateway_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk: list[Callable[[], None]] = []
    monkeypatch.setattr(DiskWriter, "write", lambda _self, write, _then: disk.append(write))
    for _ in range(2):
        robot = Robot(state=StateFolder(tmp_path))
        robot.conductor.start()
        robot.calibrate(OWN)
    disk[0]()
    with pytest.raises(ConfigError, match="another gateway had this folder"):
        disk[1]()
    calibration, fault = load(tmp_path / CALIBRATION_FILE)
    assert (calibration.revision, fault) == (1, None)


@virtual_time
async def test_what_was_delayed_on_the_way_and_what_is_no_question_is_rejected() -> None:
    robot = await started_and_quiet(limits={"max_age_ms": 100})
    robot.put(LEG_3, leg("stop", sent_ms=500, source="anna"))
    await asyncio.sleep(0.2)
    (ack,) = robot.calibrate({**OWN, "landing": {"11": 45}, "sent_ms": 501, "source": "anna"})
    assert ack.reason == Reason.STALE
    assert robot.events()[-1].legs == (1, 3)
    robot.put(keys.CALIBRATION_CMD, OWN, target=None)
    assert "takes get only" in robot.events()[-1].detail
    assert told(robot).revision == 0


GOOD = json.dumps(OWN).encode()


@pytest.mark.parametrize(
    ("query", "reason"),
    [
        ({"encoding": "application/json"}, None),
        ({"payload": ZBytes(b"{")}, Reason.MALFORMED),
        ({"payload": None}, Reason.MALFORMED),
        ({"payload": ZBytes(GOOD.ljust(MAX_PAYLOAD_BYTES))}, None),
        ({"payload": ZBytes(b"{}".ljust(MAX_PAYLOAD_BYTES + 1))}, Reason.TOO_LARGE),
        ({"encoding": "text/plain"}, Reason.BAD_ENCODING),
        ({"key_expr": "hexapod/calibration/*"}, Reason.INVALID),
    ],
)
@virtual_time
async def test_each_question_is_answered_and_a_pause_behind_it_keeps_a_flood_of_them_from_delaying_stops(
    query: dict[str, Any], reason: Reason | None
) -> None:
    robot = await started_and_quiet()
    source = SimpleNamespace(source_id=SimpleNamespace(zid="0123abc"))
    good = {"key_expr": keys.CALIBRATION_CMD, "payload": ZBytes(GOOD), "encoding": None, "source_info": source}
    asked: Any = SimpleNamespace(**{**good, **query})
    answers: list[bytes] = []
    assert robot.calibrations.note(asked, 0, answers.append)() == PAUSE_S == 0.05
    (answer,) = answers
    assert Ack.model_validate_json(answer).reason == reason
    (event,) = robot.events()
    assert (event.source, event.reason) == ("0123abc", reason)
    assert event.key == keys.CALIBRATION_CMD


@virtual_time
async def test_the_landing_pose_of_the_calibration_goes_before_that_of_the_settings() -> None:
    robot = await started_and_quiet(watchdog={"landing_ms": 500, "landing": {"31": 30, "32": 40}}, rules={"repeats": 0})
    robot.calibrate({"servos": {"31": {"inverted": True}}, "landing": {"31": 60}})
    robot.put(LEG_3, START)
    await asyncio.sleep(2)
    landed = [frame for _, frame in robot.frames if isinstance(frame, OneLeg) and not frame.is_stop][-1]
    assert [op.angle_cdeg for _, op in landed.servos if op.op is not Op.STOP][:2] == [120_00, 40_00]


# ---- what a CalibrationCommand may contain

TOKEN = "0123456789abcdef" * 2


def read(payload: bytes) -> CalibrationCommand | Rejection:
    """Return the change that is decided for a payload, or its rejection."""
    answers: Any = SimpleNamespace(
        key=keys.CALIBRATION_CMD, change=lambda event: event.change, reject=lambda _sender, why, _reply: why
    )
    return cast(CalibrationCommand | Rejection, Calibrations.read(answers, payload, 0, print)())


def test_all_that_it_may_say() -> None:
    servo = {"trim_deg": -90.0, "inverted": False, "min_deg": 12.34, "max_deg": 180.0}
    payload = {
        "servos": {str(servo_id): servo for servo_id in SERVO_IDS},
        "landing": {str(servo_id): 123.45 for servo_id in SERVO_IDS},
        "revision": 2**53,
        "accept_default": True,
        "source": ":" * 64,
        "sent_ms": 2.0**53,
        "lease": TOKEN,
    }
    assert len(json.dumps(payload)) < MAX_PAYLOAD_BYTES
    command = read(json.dumps(payload).encode())
    assert isinstance(command, CalibrationCommand)
    assert (len(command.servos), len(command.landing), command.lease) == (18, 18, TOKEN)
    assert TOKEN not in repr(command)


@pytest.mark.parametrize(
    ("payload", "reason", "detail"),
    [
        (b"", Reason.MALFORMED, "the payload is not JSON"),
        ({"servos": {"99": {}}}, Reason.INVALID, "servos.99: Input should be '11', '12',"),
        ({"servos": {"11": {"trim_deg": 400}}}, Reason.INVALID, "servos.11.trim_deg: Input should be less than or"),
        (
            {"servos": {"11": {"trim_deg": float("nan")}}},
            Reason.INVALID,
            "servos.11.trim_deg: Input should be a finite",
        ),
        ({"accept_default": False}, Reason.INVALID, "accept_default: Input should be True"),
        ({TOKEN: 7}, Reason.INVALID, "(hex digits): Extra inputs"),
        (b'{"servos": {"11": {}, "11": {}}}', Reason.INVALID, "11 is given twice in one object"),
    ],
    ids=lambda value: repr(value)[:60],
)
def test_what_is_none_is_rejected_with_the_field_and_its_limit(payload: object, reason: Reason, detail: str) -> None:
    rejection = read(payload if isinstance(payload, bytes) else json.dumps(payload).encode())
    assert isinstance(rejection, Rejection)
    assert rejection.reason == reason
    assert detail in rejection.detail
    assert TOKEN not in rejection.detail


NAMES = st.sampled_from(["servos", "landing", "11", "63", "trim_deg", "inverted", "revision", "x"])
VALUES = st.none() | st.booleans() | st.floats() | st.text(max_size=8) | st.integers()


@given(
    st.binary(max_size=200)
    | st.recursive(
        VALUES,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner),
        max_leaves=12,
    ).map(lambda made: json.dumps(made).encode())
)
def test_whatever_comes_is_read_or_rejected_and_never_raises(payload: bytes) -> None:
    assert isinstance(read(payload), CalibrationCommand | Rejection)


@given(any_calibration)
def test_what_goes_out_or_is_written_is_read_back_unchanged(calibration: RobotCalibration) -> None:
    command = read(report_of(calibration).model_dump_json().encode())
    assert isinstance(command, CalibrationCommand)
    assert changed(RobotCalibration(), command) == calibration
    assert calibration_of(report_of(calibration)) == calibration
    assert from_toml(to_toml(calibration).encode()) == calibration


# ---- the file

KEPT = RobotCalibration(3, {32: ServoMapping(7_50, inverted=True, max_cdeg=140_00)}, {31: 90_00, 32: 45_25})


def test_every_file_that_was_cut_off_is_noticed() -> None:
    text = to_toml(KEPT)
    assert from_toml(text.encode()) == KEPT
    for end in range(len(text) - 1):  # the last character is the end of the line
        with pytest.raises(ValueError, match=r"."):
            from_toml(text[:end].encode())


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("trim_deg = 7.5", "trim_deg = 100", "servos.32.trim_deg: Input should be less than or equal to 90"),
        ("trim_deg = 7.5\n", "", "servos.32 is not whole; a whole calibration names every servo"),
        ("31 = 90.0", "31 = 150.0\n[servos.31]\nmax_deg = 140.0", "is not TOML: Cannot declare ('servos', '31')"),
        ("32 = 45.25", "32 = 150", "the landing pose cannot be reached: servo 32 is calibrated to go from 0 to 140"),
        ("version = 1", "version = 2", "version is 2; this gateway reads 1"),
        ("revision = 3\n\n[landing]", "revision = 4\n\n[landing]", "the last line is not of_revision = 4"),
        ("[landing]", "[colours]", "colours: Extra inputs are not permitted"),
    ],
)
def test_a_broken_file_is_an_error_that_names_the_place(tmp_path: Path, before: str, after: str, fault: str) -> None:
    path = tmp_path / "calibration.toml"
    text = to_toml(KEPT)
    assert before in text
    path.write_text(text.replace(before, after))
    with pytest.raises(ConfigError) as raised:
        read_file(path)
    assert str(raised.value).startswith(f"{path}: {fault}")


def test_the_previous_ten_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    for revision in range(1, 15):
        write(path, RobotCalibration(revision, {32: ServoMapping(revision)}))
    kept = [read_file(found) for found in previous(path).values()]
    assert [calibration.revision for calibration in kept if calibration] == list(range(13, 13 - EARLIER_KEPT, -1))
    assert read_file(path) == RobotCalibration(14, {32: ServoMapping(14)})
    path.write_bytes(previous(path)[5].read_bytes())
    assert load(path) == (RobotCalibration(14, {32: ServoMapping(5)}), None), "put back by hand"


# ---- what a gateway starts with


@pytest.mark.parametrize("content", [b"", b"trim = 7\n", b"\xff", b" " * (MAX_CALIBRATION_BYTES + 1), None])
def test_a_file_that_cannot_be_used_is_a_fault_and_the_next_revision_is_newer_than_all(
    tmp_path: Path, content: bytes | None
) -> None:
    path = tmp_path / "calibration.toml"
    for revision in range(1, 16):
        write(path, RobotCalibration(revision))
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    found, fault = load(path)
    assert found == RobotCalibration(15)
    assert str(path) in str(fault)
    write(path, RobotCalibration(16))
    write(path, RobotCalibration(17))
    assert [each.name for each in previous(path).values()][:2] == ["calibration.16.toml", "calibration.14.toml"]


def test_the_folder_that_a_command_reads_without_systemd(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert state_directory("") is None
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/var/lib/other")
    assert state_directory("") == state_to_read("") == tmp_path
    assert state_directory("/mnt/own") == Path("/mnt/own")
