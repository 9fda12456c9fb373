"""The guard's quick look accepts just what reading the frame and writing it again accepts."""

import itertools

from gateway.protocol.frames import FrameError, decode
from gateway.spi.guard import _is_frame

EDGES = (0, 1, 2, 3, 4, 99, 100, 179, 180, 181, 255)


def is_written_so(data: bytes) -> bool:
    try:
        return decode(data).to_bytes() == data
    except FrameError:
        return False


def test_on_every_operation_and_angle() -> None:
    for operation in itertools.product(EDGES, range(256), EDGES):
        for data in (bytes((6, 2, 11, *operation)), bytes((14, 1, 11, 2, 0, 0, 12, *operation, 13, 1, 90, 0))):
            assert _is_frame(data) == is_written_so(data), data.hex(" ")


def test_with_any_one_byte_changed_and_at_any_length() -> None:
    for good in (bytes((6, 2, 43, 3, 90, 50)), bytes((14, 1, 41, 1, 90, 0, 42, 2, 0, 0, 43, 3, 180, 0))):
        assert _is_frame(good)
        for index, byte in itertools.product(range(len(good)), range(256)):
            data = good[:index] + bytes((byte,)) + good[index + 1 :]
            assert _is_frame(data) == is_written_so(data), data.hex(" ")
        for length in range(len(good) + 8):
            data = (good + good)[:length]
            assert _is_frame(data) == is_written_so(data), data.hex(" ")
