"""ROS 2's messages as bytes: compared with what CycloneDDS wrote, and with the types of each distribution."""

import logging
from typing import Final

import pytest

from gateway.people.recorder.drawing import encode
from gateway.people.ros2.messages import Header, Imu, JointState, Message, String, Time
from gateway.people.ros2.received import SILENT_S, Rivals, presence, read_each
from tests.support.ros2_messages import Duration, JointTrajectory, JointTrajectoryPoint

_HEADER: Final = Header(Time(1, 2), "base_link")
CYCLONE: Final = (
    (
        JointState(_HEADER, ("joint_11", "j"), (0.5, -1.25)),
        "0001000001000000020000000a000000626173655f6c696e6b00000002000000090000006a6f696e745f313100000000020000006a000000"
        "02000000000000000000e03f000000000000f4bf0000000000000000",
    ),
    (JointState(), "000100000000000000000000010000000000000000000000000000000000000000000000"),
    (
        JointTrajectory(
            _HEADER,
            ("joint_11",),
            (
                JointTrajectoryPoint((0.5,), time_from_start=Duration(0, 5)),
                JointTrajectoryPoint((1.5,), (0.25,), time_from_start=Duration(-1, 999_999_999)),
            ),
        ),
        "0001000001000000020000000a000000626173655f6c696e6b00000001000000090000006a6f696e745f31310000000002000000010000000000"
        "0000000000000000e03f000000000000000000000000000000000500000001000000000000000000f83f0100000000000000000000000000d03f"
        "0000000000000000ffffffffffc99a3b",
    ),
)
"""Written by `cyclonedds` 11.0.1, which builds where there is no wheel, and so is not asked each time."""


@pytest.mark.parametrize(("message", "expected"), CYCLONE, ids=["joints", "empty", "trajectory"])
def test_cyclonedds_writes_the_same_bytes(message: Message, expected: str) -> None:
    assert encode(message).hex() == expected


def test_what_cannot_be_written_is_reported() -> None:
    short = Imu(orientation_covariance=(0.0,) * 8)
    for message in (String("\ud800"), Time(2**31, 0), Duration(0, -1), short):
        with pytest.raises(ValueError, match="cannot be written"):
            encode(message)


# ---- who sends


A, B, C = b"a", b"b", b"c"


@pytest.mark.parametrize(
    ("sender", "before", "now", "there"),
    [
        (A, {A, B}, {A}, True),
        (A, {A, B}, {B}, False),
        (C, {A, B}, {A, B}, True),
        (C, {A, B}, {B}, False),
        (C, set(), {A}, False),
        (b"", {A}, {A, B}, True),
        (b"", {A}, {B}, False),
    ],
)
def test_a_sender_that_is_not_seen_is_there_while_all_others_are(
    sender: bytes, before: set[bytes], now: set[bytes], there: bool
) -> None:
    present = set(before)
    is_there = presence(sender, lambda: present)
    present.clear()
    present.update(now)
    assert is_there() is there


def test_an_error_in_one_message_does_not_end_the_topic(caplog: pytest.LogCaptureFixture) -> None:
    taken: list[int] = []

    def take(number: int) -> None:
        taken.append(10 // number)

    with caplog.at_level(logging.ERROR):
        read_each([5, 0, 2], take)
    assert taken == [2, 5]
    assert "a message could not be handled" in caplog.text


def test_the_first_is_followed_until_it_is_silent() -> None:
    rivals = Rivals()
    assert rivals.may_send(B, 0.0), "nobody has sent"
    rivals.sent(A, 10.0)
    assert rivals.may_send(A, 10.1)
    assert not rivals.may_send(B, 10.1)
    rivals.sent(A, 10.2)
    assert not rivals.may_send(B, 10.2 + SILENT_S)
    assert rivals.may_send(B, 10.3 + SILENT_S)
    rivals.sent(B, 10.3 + SILENT_S)
    assert not rivals.may_send(A, 10.4 + SILENT_S), "and now the other"
