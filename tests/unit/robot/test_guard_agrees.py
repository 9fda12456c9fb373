"""The guard's quick look accepts just what reading the frame and writing it again accepts."""

import itertools

import pytest

from gateway.robot.protocol.frames import FrameError, Op, decode
from gateway.robot.spi.guard import _is_frame

EDGES = (0, 1, 2, 3, 4, 99, 100, 179, 180, 181, 255)


INTERVALS = ((0, 0), (1_00, 4_00), (99_50, 180_01))
"""Angles that are never sent; in the first case, none."""


def is_written_so(data: bytes, avoid_from_cdeg: int, avoid_to_cdeg: int) -> bool:
    try:
        frame = decode(data)
    except FrameError:
        return False
    moves = [servo.angle_cdeg for _, servo in frame.servos if servo.op is not Op.STOP]
    return frame.to_bytes() == data and not any(avoid_from_cdeg <= angle < avoid_to_cdeg for angle in moves)


@pytest.mark.parametrize("avoid", INTERVALS)
def test_on_every_operation_and_angle(avoid: tuple[int, int]) -> None:
    for operation in itertools.product(EDGES, range(256), EDGES):
        for data in (bytes((6, 2, 11, *operation)), bytes((14, 1, 11, 2, 0, 0, 12, *operation, 13, 1, 90, 0))):
            assert _is_frame(data, *avoid) == is_written_so(data, *avoid), data.hex(" ")


def test_with_any_one_byte_changed_and_at_any_length() -> None:
    for good in (bytes((6, 2, 43, 3, 90, 50)), bytes((14, 1, 41, 1, 90, 0, 42, 2, 0, 0, 43, 3, 180, 0))):
        assert _is_frame(good, 0, 0)
        for index, byte in itertools.product(range(len(good)), range(256)):
            data = good[:index] + bytes((byte,)) + good[index + 1 :]
            assert _is_frame(data, 0, 0) == is_written_so(data, 0, 0), data.hex(" ")
        for length in range(len(good) + 8):
            data = (good + good)[:length]
            assert _is_frame(data, 0, 0) == is_written_so(data, 0, 0), data.hex(" ")
