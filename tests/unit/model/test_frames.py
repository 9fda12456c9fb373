"""Frames to bytes and back: published vectors, one byte off, each field out of range, every legal frame. Framings."""

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.frames import (
    STOP,
    STOP_REPEAT_MS,
    STOP_REPEATS,
    Frame,
    FrameError,
    Framing,
    OneLeg,
    OneServo,
    Op,
    ServoOp,
    avoided_by,
    centidegrees,
    decode,
    legs_of,
    servo_ids_of,
)
from schemas.robot import SERVO_IDS

VECTORS: dict[str, Any] = json.loads((Path(__file__).parents[2] / "data" / "frames.json").read_text())
LEGAL: list[dict[str, Any]] = VECTORS["legal"]
ILLEGAL: list[dict[str, str]] = VECTORS["illegal"]

NAMES_A_BYTE = re.compile(r"^byte \d+ is (missing|too many|\d+ \(0x[0-9a-f]{2}\))")

servo_ops = st.one_of(
    st.just(STOP), st.builds(ServoOp, st.sampled_from([Op.START, Op.SET]), st.integers(min_value=0, max_value=180_00))
)
frames: st.SearchStrategy[Frame] = st.one_of(
    st.builds(OneServo, st.sampled_from(SERVO_IDS), servo_ops),
    st.builds(OneLeg, st.integers(min_value=1, max_value=6), st.tuples(servo_ops, servo_ops, servo_ops)),
)
bytes_near_a_frame = st.one_of(
    st.binary(max_size=20),
    st.builds(
        lambda frame, index, value: bytes(value if i == index else byte for i, byte in enumerate(frame.data)),
        frames,
        st.integers(0, 13),
        st.integers(0, 255),
    ),
)


def servo_op(described: dict[str, Any]) -> ServoOp:
    return ServoOp(Op[described["op"].upper()], centidegrees(described.get("angle_deg", 0)))


def frame_of(vector: dict[str, Any]) -> Frame:
    if vector["frame"] == "ONE LEG":
        first, second, third = (servo_op(described) for described in vector["servos"])
        return OneLeg(vector["leg"], (first, second, third))
    return OneServo(vector["servo"], servo_op(vector))


def test_the_ids_are_leg_then_joint() -> None:
    assert SERVO_IDS == (11, 12, 13, 21, 22, 23, 31, 32, 33, 41, 42, 43, 51, 52, 53, 61, 62, 63)
    assert legs_of(SERVO_IDS[4:]) == (2, 3, 4, 5, 6)
    assert servo_ids_of(3) == (31, 32, 33)


@pytest.mark.parametrize("vector", LEGAL, ids=lambda vector: vector["bytes"])
def test_legal_vectors_both_ways(vector: dict[str, Any]) -> None:
    data = bytes.fromhex(vector["bytes"])
    frame = frame_of(vector)
    assert frame.data == data
    assert decode(data) == frame


@pytest.mark.parametrize("vector", ILLEGAL, ids=lambda vector: vector["why"])
def test_illegal_vectors_are_rejected_by_name_of_the_byte(vector: dict[str, str]) -> None:
    with pytest.raises(FrameError, match=NAMES_A_BYTE):
        decode(bytes.fromhex(vector["bytes"]))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("06 02 0e 01 5a 00", "byte 3 is 14 (0x0e); a servo id is leg 1-6 then joint 1-3, such as 13"),
        ("06 02 0b 04 5a 00", "byte 4 is 4 (0x04); an OP is 1 (Start), 2 (Stop) or 3 (Set)"),
        ("06 02 0b 03 b5 00", "byte 5 is 181 (0xb5); INT PART is 0 to 180 whole degrees"),
        ("06 02 0b 03 5a 64", "byte 6 is 100 (0x64); FLOAT PART is 0 to 99 hundredths of a degree"),
        ("06 02 0b 03 b4 01", "byte 6 is 1 (0x01) after 180 whole degrees; the largest angle is 180.00"),
        ("06 02 0b 03 5a", "byte 6 is missing; a ONE SERVO frame has 6 bytes, here are 5"),
        ("06 02 0b 03 5a 00 00", "byte 7 is too many; a ONE SERVO frame has 6 bytes, here are 7"),
        ("", "byte 1 is missing; a frame starts with FRAME LEN and FRAME TYPE"),
        ("06", "byte 2 is missing; a frame starts with FRAME LEN and FRAME TYPE"),
        ("06 02", "byte 3 is missing; a ONE SERVO frame has 6 bytes, here are 2"),
        ("07 02", "byte 1 is 7 (0x07); the FRAME LEN of a ONE SERVO frame (FRAME TYPE 2) is 6"),
        ("06 03", "byte 2 is 3 (0x03); a FRAME TYPE is 1 (ONE LEG) or 2 (ONE SERVO)"),
        (
            "0e 01 0b 01 5a 00 0c 01 5a 00 17 01 5a 00",
            "byte 11 is 23 (0x17) in place of 13; a ONE LEG frame holds joints 1, 2, 3 of one leg",
        ),
    ],
)
def test_a_frame_that_is_wrong_is_named_in_a_sentence(data: str, message: str) -> None:
    with pytest.raises(FrameError) as rejection:
        decode(bytes.fromhex(data))
    assert str(rejection.value) == message


def test_a_stop_is_repeated_three_times_each_20_ms() -> None:
    """As docs/stops.md says of every Stop."""
    assert (STOP_REPEATS, STOP_REPEAT_MS) == (3, 20)


NO_SERVOS = (*range(-1, 11), 14, 20, 24, 64, 70, 71, 256 + 11, True, "11")


@pytest.mark.parametrize(
    ("make", "wrong", "sentence"),
    [
        *((partial(OneServo, command=STOP), bad, f"servo id is {bad}; a servo id is leg 1-6") for bad in NO_SERVOS),
        *((partial(OneLeg, commands=(STOP,) * 3), bad, f"leg is {bad}; it is 1 to 6") for bad in (-1, 0, 7, 11)),
        *((partial(ServoOp, Op.SET), bad, f"angle is {bad}") for bad in (-1, 180_01)),
        (partial(ServoOp, Op.STOP), 1, "a Stop has none"),
    ],
)
def test_what_is_no_id_leg_or_angle(make: Callable[[Any], object], wrong: object, sentence: str) -> None:
    with pytest.raises(FrameError, match=sentence):
        make(wrong)


@given(frames)
def test_every_legal_frame_survives_the_wire(frame: Frame) -> None:
    data = frame.data
    assert data[0] == len(data)
    assert frame.is_stop is all(op is STOP for _, op in frame.servos)
    assert decode(data) == frame


@given(st.binary(max_size=80) | bytes_near_a_frame)
def test_any_bytes_are_a_frame_or_an_error_that_names_the_byte(data: bytes) -> None:
    """A frame is written as it was read, besides a Stop's angle."""
    written, why_not = b"", ""
    try:
        written = decode(data).data
    except FrameError as error:
        why_not = str(error)
    canonical = bytearray(data)
    for record in range(2, len(written), 4):
        if data[record + 1] == Op.STOP:
            canonical[record + 2 : record + 4] = b"\0\0"
    assert re.fullmatch(r"byte [ -~]{1,195}", why_not) if why_not else written == canonical


# ---- the two framings


def test_angles_of_which_the_published_firmware_can_die() -> None:
    """One to, without, four degrees: its ids 1 to 3 with operations 1 to 3 (tests/deaf)."""
    assert (Framing.PLAIN.avoid_cdeg, Framing.LENGTH_PREFIXED.avoid_cdeg) == (None, (100, 400))
    assert [avoided_by(name) for name in ("plain", "length-prefixed", "of a later version")] == [None, (100, 400), None]


def test_how_fast_each_takes_its_bytes() -> None:
    """What is faster: test_settings.py."""
    assert [(framing.most_hz, framing.least_gap_us) for framing in Framing] == [(20_000_000, 0.0), (5_000_000, 20.0)]
    assert [framing.too_fast(framing.most_hz, framing.least_gap_us) for framing in Framing] == ["", ""]
