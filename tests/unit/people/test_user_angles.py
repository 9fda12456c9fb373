"""A calibrated robot's frames in users' angles, by what was published before them."""

from typing import Any

import pytest

from gateway.model.calibration import RobotCalibration, ServoMapping, report_of
from gateway.model.frames import OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.people.recorder.messages import RecordedMessage
from gateway.people.recorder.story import frames_in
from gateway.people.ros2.commanded import UserAngles
from schemas.keys import CALIBRATION, FRAME, STATE

MIRRORED = RobotCalibration(1, {31: ServoMapping(7_50), 32: ServoMapping(-10_00, inverted=True)})
OTHER = RobotCalibration(2, {31: ServoMapping(-20_00)})
USERS = OneLeg(3, (ServoOp(Op.SET, 90_00), ServoOp(Op.SET, 45_00), ServoOp(Op.START, 120_00)))


def frame(calibration: RobotCalibration, users: OneLeg | OneServo = USERS) -> RecordedMessage:
    """As it was written with this calibration in force."""
    return RecordedMessage(FRAME, {"bytes": calibration.frame(users).to_bytes().hex(), "cause": "command"}, 0)


def state(revision: int | None) -> RecordedMessage:
    content: dict[str, Any] = {} if revision is None else {"calibration": {"revision": revision}}
    return RecordedMessage(STATE, content, 0)


def told(calibration: RobotCalibration) -> RecordedMessage:
    return RecordedMessage(CALIBRATION, report_of(calibration).model_dump(mode="json"), 0)


def read(*messages: RecordedMessage) -> list[OneLeg | OneServo]:
    return [found for _, found in frames_in(messages)]


def test_each_frame_is_read_by_the_calibration_before_it() -> None:
    stop = stop_leg(3)
    found = read(
        state(0), frame(RobotCalibration()), told(MIRRORED), state(1), frame(MIRRORED), told(OTHER), frame(OTHER),
        frame(OTHER, stop), frame(OTHER, OneServo(31, ServoOp(Op.SET, 30_00))),
    )  # fmt: skip
    assert found == [USERS, USERS, USERS, stop, OneServo(31, ServoOp(Op.SET, 30_00))]


@pytest.mark.parametrize(
    "message",
    [
        state(1),
        RecordedMessage(CALIBRATION, {"revision": "x"}, 0),
        RecordedMessage(CALIBRATION, {"revision": 1, "servos": {"99": {}}, "landing": {}}, 0),
    ],
    ids=["state without", "no calibration", "no servo"],
)
def test_where_the_calibration_in_force_is_unknown_it_is_known_to_be(message: RecordedMessage) -> None:
    angles = UserAngles()
    angles.take(message.topic, message.content)
    assert not angles.consistent
    assert angles.frame(frame(MIRRORED).content) == MIRRORED.frame(USERS), "as on the wire"
    angles.take(CALIBRATION, told(MIRRORED).content)
    assert angles.consistent


def test_bytes_that_no_user_meant_stay_as_they_are() -> None:
    low = OneServo(31, ServoOp(Op.SET, 0))  # its user would have said -7.5
    assert read(told(MIRRORED), RecordedMessage(FRAME, {"bytes": low.to_bytes().hex()}, 0)) == [low]
    assert read(told(MIRRORED), RecordedMessage(FRAME, {"bytes": "00"}, 0)) == []
