"""A calibration, from the payload on `hexapod/calibration/cmd` to the answer, the frames, the events and the state."""

import asyncio
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OneLeg, Op
from gateway.robot.host.calibration_file import SLOW_S
from gateway.robot.runtime.calibrations import HANGS
from gateway.robot.runtime.request_answers import PAUSE_S
from schemas import calibration, keys
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.telemetry import Ack, Kind, Reason
from tests.support.robot import LEG_3, START, Robot, leg, started_and_quiet

OWN = {"servos": {"31": {"trim_deg": 7.5}, "32": {"inverted": True, "trim_deg": -10}, "33": {"max_deg": 140}}}
pytestmark = pytest.mark.virtual_time


Disk = list[Callable[[str | None], None]]
"""Called with None, each says that a calibration is on the disk."""


async def on_disk() -> tuple[Robot, Disk]:
    disk: Disk = []
    robot = Robot(keep=lambda _, then: disk.append(then))
    robot.conductor.start()
    robot.conductor.reports.announce_start()
    await asyncio.sleep(1)
    robot.controller.transfers.clear()
    robot.reports.clear()
    return robot, disk


def told(robot: Robot) -> calibration.Calibration:
    answers: list[bytes] = []
    robot.calibrations.answer(answers.append)
    return calibration.Calibration.model_validate_json(answers[0])


async def test_it_is_told_when_it_changes_and_when_somebody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await started_and_quiet()
    recorded: list[RobotCalibration] = []
    monkeypatch.setattr(robot.conductor.recorder, "calibration", recorded.append)
    robot.calibrations.announce_start()
    first = told(robot)
    assert (first.revision, len(first.servos), first.landing) == (0, 18, {})
    robot.calibrate({**OWN, "landing": {"11": 45}})
    published = [report for key, report in robot.reports if key == keys.CALIBRATION]
    assert published == [first, told(robot)]
    assert [each.revision for each in recorded] == [0, 1]
    assert told(robot).servos["32"] == calibration.ServoCalibration(trim_deg=-10, inverted=True)
    assert told(robot).landing == {"11": 45}
    state = robot.states[-1].calibration
    assert (state.revision, state.fault, state.kept) == (1, None, False)


async def test_a_disk_that_hangs_is_logged_and_whoever_waits_for_it_learns_that(
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot, disk = await on_disk()
    answers = robot.calibrate(OWN)
    await asyncio.sleep(SLOW_S - 0.01)
    (soon,) = robot.calibrate({"servos": {"61": {"trim_deg": 1}}})
    assert HANGS not in caplog.text + str(soon.detail)
    await asyncio.sleep(0.02)
    assert caplog.text.count("is not kept yet") == 1
    (late,) = robot.calibrate({"servos": {"61": {"trim_deg": 1}}})
    assert (late.reason, late.detail) == (Reason.STALE, f"another change of the calibration is being saved; {HANGS}")
    assert str(robot.ask(LEG_3, START).detail).endswith(HANGS)
    assert robot.ask(keys.leg_command(1), START).accepted, "what it does not change goes on"
    await asyncio.sleep(0.3)
    assert robot.events(Kind.WATCHDOG_EXPIRED)
    assert robot.ask(keys.ESTOP).stop_frames == 6
    disk.pop(0)(None)
    assert (answers[0].accepted, told(robot).revision) == (True, 1), "it came back"
    assert robot.ask(keys.RESET, {"estop": 1}).accepted
    robot.calibrate({"servos": {"61": {"trim_deg": 1}}})
    assert HANGS not in str(robot.calibrate(OWN)[0].detail), "this one has just begun"
    disk.pop(0)(None)
    await asyncio.sleep(SLOW_S + 1)
    assert caplog.text.count("is not kept yet") == 1, "and ended in time"


async def test_what_was_delayed_on_the_way_is_rejected() -> None:
    robot = await started_and_quiet(limits={"max_age_ms": 100})
    robot.put(LEG_3, leg("stop", sent_ms=500, source="anna"))
    await asyncio.sleep(0.2)
    (ack,) = robot.calibrate({**OWN, "landing": {"11": 45}, "sent_ms": 501, "source": "anna"})
    assert ack.reason == Reason.STALE
    assert robot.events()[-1].legs == (1, 3)
    assert told(robot).revision == 0


async def test_what_comes_after_the_end_changes_nothing() -> None:
    robot, disk = await on_disk()
    answers = robot.calibrate(OWN)
    robot.conductor.shut_down()
    robot.conductor.close()
    disk.pop(0)(None)
    assert robot.calibrate(OWN) == answers == []


async def test_what_is_no_command_is_answered_and_told() -> None:
    robot = await started_and_quiet()
    (ack,) = robot.calibrate({"servos": {"11": {"trim_deg": 400}}})
    assert (ack.reason, ack.detail) == (Reason.INVALID, "servos.11.trim_deg: Input should be less than or equal to 90")
    (event,) = robot.events()
    assert (event.kind, event.key, event.reason) == (Kind.COMMAND_REJECTED, keys.CALIBRATION_CMD, Reason.INVALID)
    robot.put(keys.CALIBRATION_CMD, OWN, target=None)
    assert "takes get only" in robot.events()[-1].detail
    (ack,) = robot.calibrate({"accept_default": True})
    assert ack.reason is Reason.INVALID, "the calibration in force can be trusted"
    assert told(robot).revision == 0


class Bytes(bytes):
    def to_bytes(self, *_: object) -> bytes:
        return self


GOOD = Bytes(json.dumps(OWN).encode())


@pytest.mark.parametrize(
    ("query", "reason"),
    [
        ({"encoding": "application/json"}, None),
        ({"payload": Bytes(b"{")}, Reason.MALFORMED),
        ({"payload": None}, Reason.MALFORMED),
        ({"payload": Bytes(GOOD.ljust(MAX_PAYLOAD_BYTES))}, None),
        ({"payload": Bytes(b"{}".ljust(MAX_PAYLOAD_BYTES + 1))}, Reason.TOO_LARGE),
        ({"encoding": "text/plain"}, Reason.BAD_ENCODING),
        ({"key_expr": "hexapod/calibration/*"}, Reason.INVALID),
    ],
)
async def test_each_question_is_answered_and_a_pause_behind_it_keeps_a_flood_of_them_from_delaying_stops(
    query: dict[str, Any], reason: Reason | None
) -> None:
    robot = await started_and_quiet()
    source = SimpleNamespace(source_id=SimpleNamespace(zid="0123abc"))
    good = {"key_expr": keys.CALIBRATION_CMD, "payload": GOOD, "encoding": None, "source_info": source}
    asked: Any = SimpleNamespace(**{**good, **query})
    answers: list[bytes] = []
    assert robot.calibrations.note(asked, 0, answers.append)() == PAUSE_S == 0.05
    (answer,) = answers
    assert Ack.model_validate_json(answer).reason == reason
    (event,) = robot.events()
    assert (event.source, event.reason) == ("0123abc", reason)


async def test_the_landing_pose_of_the_calibration_goes_before_that_of_the_settings() -> None:
    robot = await started_and_quiet(watchdog={"landing_ms": 500, "landing": {"31": 30, "32": 40}}, rules={"repeats": 0})
    robot.calibrate({"servos": {"31": {"inverted": True}}, "landing": {"31": 60}})
    robot.put(LEG_3, START)
    await asyncio.sleep(2)
    landed = [frame for _, frame in robot.frames if isinstance(frame, OneLeg) and not frame.is_stop][-1]
    assert [op.angle_cdeg for op in landed.commands if op.op is not Op.STOP][:2] == [120_00, 40_00]
