"""A calibrated robot's frames in users' angles, by what its recording says; where it says nothing, to whom they go."""

from pathlib import Path
from typing import Any

import pytest

from gateway.errors import ConfigError
from gateway.model.calibration import RobotCalibration, ServoMapping, report_of
from gateway.model.frames import OneLeg, OneServo, Op, ServoOp, decode, stop_leg
from gateway.people.recordings.reading import RecordedMessage
from gateway.people.recordings.user_angles import UserAngles, user_bytes
from gateway.people.tools.replay import _same_angles
from schemas.keys import CALIBRATION, FRAME, STATE

PATH = Path("ride.mcap")
MIRRORED = RobotCalibration(1, {31: ServoMapping(7_50), 32: ServoMapping(-10_00, inverted=True)})
OTHER = RobotCalibration(2, {31: ServoMapping(-20_00)})
USERS = OneLeg(3, (ServoOp(Op.SET, 90_00), ServoOp(Op.SET, 45_00), ServoOp(Op.START, 120_00)))


def frame(calibration: RobotCalibration, users: OneLeg | OneServo = USERS) -> RecordedMessage:
    """As it was written with this calibration in force."""
    return RecordedMessage(FRAME, {"bytes": calibration.frame(users).to_bytes().hex(), "cause": "command"}, 0, 0)


def state(revision: int | None) -> RecordedMessage:
    content: dict[str, Any] = {} if revision is None else {"calibration": {"revision": revision}}
    return RecordedMessage(STATE, content, 0, 0)


def told(calibration: RobotCalibration) -> RecordedMessage:
    return RecordedMessage(CALIBRATION, report_of(calibration).model_dump(mode="json"), 0, 0)


def read(*messages: RecordedMessage) -> tuple[UserAngles, list[OneLeg | OneServo]]:
    angles = UserAngles()
    return angles, [decode(bytes.fromhex(record["bytes"])) for record in angles.frames(messages)]


def test_each_frame_is_read_by_the_calibration_before_it() -> None:
    stop = stop_leg(3)
    angles, found = read(
        state(0), frame(RobotCalibration()), told(MIRRORED), state(1), frame(MIRRORED), told(OTHER), frame(OTHER),
        frame(OTHER, stop), frame(OTHER, OneServo(31, ServoOp(Op.SET, 30_00))),
    )  # fmt: skip
    assert found == [USERS, USERS, USERS, stop, OneServo(31, ServoOp(Op.SET, 30_00))]
    assert (angles.known, angles.translated) == (True, True)
    _same_angles(PATH, angles, OTHER)


@pytest.mark.parametrize(
    "messages",
    [
        (frame(MIRRORED),),
        (state(1), frame(MIRRORED)),
        (state(0), frame(RobotCalibration()), state(1), frame(MIRRORED)),
        (RecordedMessage(CALIBRATION, {"revision": "x"}, 0, 0), frame(MIRRORED)),
        (RecordedMessage(CALIBRATION, {"revision": 1, "servos": {"99": {}}, "landing": {}}, 0, 0), frame(MIRRORED)),
    ],
    ids=["frames alone", "state without", "changed unheard", "no calibration", "no servo"],
)
def test_where_it_does_not_say_frames_go_only_where_the_same_bytes_are_written(
    messages: tuple[RecordedMessage, ...],
) -> None:
    angles, found = read(*messages)
    assert not angles.known
    assert found[-1] == MIRRORED.frame(USERS)
    _same_angles(PATH, angles, RobotCalibration(7, {}, {11: 90_00}))
    with pytest.raises(ConfigError, match="does not contain the calibration"):
        _same_angles(PATH, angles, OTHER)


def test_where_it_says_so_of_a_part_only_nothing_is_sent() -> None:
    angles, _ = read(told(MIRRORED), frame(MIRRORED), state(5), frame(OTHER))
    assert not angles.known
    with pytest.raises(ConfigError, match="nothing is sent"):
        _same_angles(PATH, angles, RobotCalibration())


def test_bytes_that_no_user_meant_stay_as_they_are() -> None:
    low = OneServo(31, ServoOp(Op.SET, 0)).to_bytes()  # its user would have said -7.5
    assert user_bytes(MIRRORED, low) == low
    assert user_bytes(MIRRORED, b"\x00") == b"\x00"
