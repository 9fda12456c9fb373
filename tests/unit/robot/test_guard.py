"""The guard at the device's edge: a batch passes if and only if the framing makes all of it of legal frames."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.frames import STOP, FrameError, Framing, OneLeg, OneServo, Op, ServoOp, decode, stop_leg
from gateway.robot.spi.guard import IllegalTransferError, check
from tests.support.controllers import on_wire
from tests.unit.model.test_frames import ILLEGAL, bytes_near_a_frame, frames

PREFIXED = Framing.LENGTH_PREFIXED
STOP_1 = stop_leg(1).data
START_11 = OneServo(11, ServoOp(Op.START, 90_00)).data
ZERO = b"\0"


def passes(framing: Framing, *data: bytes) -> bool:
    try:
        check([(each, 7) for each in data], range(0), announces=framing is PREFIXED)
    except IllegalTransferError:
        return False
    return True


def is_written_so(data: bytes, avoid_from_cdeg: int = 0, avoid_to_cdeg: int = 0) -> bool:
    """Return whether these bytes are a frame that is written again in the same way. No angle is avoided."""
    try:
        frame = decode(data)
    except FrameError:
        return False
    moves = [servo.angle_cdeg for _, servo in frame.servos if servo.op is not Op.STOP]
    return frame.data == data and not any(avoid_from_cdeg <= angle < avoid_to_cdeg for angle in moves)


def legal(framing: Framing, data: list[bytes]) -> bool:
    """Return whether nothing is left after cutting into zeros and frames: another form of the rule."""
    left = list(data)
    while left:
        first = left.pop(0)
        if framing is PREFIXED:
            if first == ZERO:
                continue
            if not (left and len(first) == 1 and first[0] == len(left[0])):
                return False
            first = left.pop(0)
        if not is_written_so(first):
            return False
    return True


parts = st.one_of(
    frames.map(lambda frame: [frame.data]),
    frames.map(lambda frame: on_wire(PREFIXED, frame)),
    bytes_near_a_frame.map(lambda data: [data]),
    bytes_near_a_frame.map(lambda data: [bytes((min(len(data), 255),)), data]),
    st.sampled_from([[ZERO], [ZERO] * 16, [b"\x06"], [b"\x0e"], [bytes(16)], [STOP_1], [START_11]]),
)


@given(st.lists(parts, min_size=1, max_size=6), st.sampled_from(Framing))
def test_legal_frames_pass_and_nothing_else(batch: list[list[bytes]], framing: Framing) -> None:
    data = [each for part in batch for each in part]
    assert passes(framing, *data) is legal(framing, data)


def test_an_announcement_and_its_body_are_in_one_batch() -> None:
    assert not passes(PREFIXED, b"\x0e")
    assert not passes(PREFIXED, b"\x0e", STOP_1, b"\x06")
    assert not passes(PREFIXED, STOP_1)
    assert not passes(PREFIXED, b"\x0e", ZERO)
    assert not passes(PREFIXED, b"\x0e", START_11), "a legal frame, and not the one announced"
    assert not passes(PREFIXED, b"\x06", STOP_1)
    assert passes(PREFIXED, ZERO, b"\x0e", STOP_1, ZERO)


@pytest.mark.parametrize("framing", Framing)
@pytest.mark.parametrize("vector", ILLEGAL, ids=lambda vector: vector["why"])
def test_no_illegal_vector_passes_also_behind_a_legal_frame(framing: Framing, vector: dict[str, str]) -> None:
    data = bytes.fromhex(vector["bytes"])
    announcement = [b"\x0e" if len(data) == 14 else b"\x06"] if framing is PREFIXED else []
    assert not passes(framing, *announcement, data)
    assert not passes(framing, *on_wire(framing, STOP_1), *announcement, data)
    assert not passes(framing, *announcement, data, *on_wire(framing, STOP_1))


def test_the_reason_is_the_first_servo_within_the_interval_which_has_its_beginning_and_not_its_end() -> None:
    frame = OneLeg(6, (ServoOp(Op.SET, 4_00), ServoOp(Op.SET, 1_00), STOP))
    with pytest.raises(IllegalTransferError, match="moves servo 62 to 1 degrees"):
        check([(frame.data, 0)], range(1_00, 4_00), announces=False)


# ---- the guard accepts just what reading the frame and writing it again accepts


def is_checked(data: bytes, avoid_from_cdeg: int = 0, avoid_to_cdeg: int = 0) -> bool:
    """Return whether the guard's own description of a frame fits."""
    try:
        check([(data, 0)], range(avoid_from_cdeg, avoid_to_cdeg), announces=False)
    except IllegalTransferError:
        return False
    return True


EDGES = (0, 1, 2, 3, 4, 99, 100, 179, 180, 181, 255)
INTERVALS = ((0, 1), (1_00, 4_00), (99_50, 180_01))
"""Angles that are never sent. The first has the 0 that is written in a Stop, which has no angle."""


@pytest.mark.lengthy
@pytest.mark.parametrize("avoid", INTERVALS)
def test_every_operation_and_angle_passes_only_in_a_legal_frame(avoid: tuple[int, int]) -> None:
    for operation in itertools.product(EDGES, range(256), EDGES):
        for data in (bytes((6, 2, 11, *operation)), bytes((14, 1, 11, 2, 0, 0, 12, *operation, 13, 1, 90, 0))):
            assert is_checked(data, *avoid) == is_written_so(data, *avoid), data.hex(" ")


def test_a_frame_with_a_byte_changed_or_another_length_passes_only_if_it_is_legal() -> None:
    for good in (bytes((6, 2, 43, 3, 90, 50)), bytes((14, 1, 41, 1, 90, 0, 42, 2, 0, 0, 43, 3, 180, 0))):
        assert is_checked(good)
        for index, byte in itertools.product(range(len(good)), range(256)):
            data = good[:index] + bytes((byte,)) + good[index + 1 :]
            assert is_checked(data) == is_written_so(data), data.hex(" ")
        for length in range(len(good) + 8):
            data = (good + good)[:length]
            assert is_checked(data) == is_written_so(data), data.hex(" ")
