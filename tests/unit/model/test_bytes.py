"""The bytes of elkapod-2025 and of the power board: published vectors as literals, and whatever else may come."""

import math
from collections.abc import Callable, Collection
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.model.elkapod import (
    HEARTBEAT_BYTES,
    MIDDLE_CDEG,
    SHUTDOWN,
    START,
    UART_BAUD,
    AnswerError,
    answer,
    frame,
    heartbeat,
    heartbeats,
    measured,
)
from gateway.model.power_board import (
    ALL,
    ASK_CURRENTS,
    ASK_RAILS,
    UNREADABLE,
    Answer,
    BoardError,
    BoardValues,
    CanFrame,
    mask_of,
    read,
    set_supply,
)
from tests.support.robot import angles_of

FRAME = bytes.fromhex(
    "7e0000a0420000a2420000a4420000a6420000a8420000aa420000ac420000ae420000b0420000b2420000b4420000b6420000b8420000ba"
    "420000bc420000be420000c0420000c2420000000000000f"
)
"""80, 81, … 97 degrees."""
ANSWER = bytes.fromhex(
    "7e0000fc41cdccec400000a0420000803f0000000000000000000000000000000000000000000000000000000000000000c3f51c410000803f"
    "0000004000004040000080400000a0400000c04000000f"
)
"""31.5 °C, 7.4 V, 80 %, level, at rest under 9.81 m/s², feet 1 to 6."""


# ---- frames


def test_a_frame_has_the_published_bytes() -> None:
    assert frame(range(80_00, 98_00, 1_00)) == FRAME


@given(st.lists(st.integers(0, 180_00), min_size=18, max_size=18))
def test_every_legal_angle_comes_back(angles_cdeg: list[int]) -> None:
    data = frame(angles_cdeg)
    assert [round(100 * angle_deg) for angle_deg in angles_of(data).values()] == angles_cdeg
    assert (len(data), data[0], data[73:]) == (80, 0x7E, b"\0\0\0\0\0\0\x0f")


@pytest.mark.parametrize(
    ("call", "wrong", "error", "sentence"),
    [
        (frame, [MIDDLE_CDEG] * 17, ValueError, "shorter"),
        (frame, [-1] + [MIDDLE_CDEG] * 17, ValueError, "servo 11 at -1 hundredths"),
        (frame, [MIDDLE_CDEG] * 17 + [180_01], ValueError, "servo 63 at 18001 hundredths"),
        (measured, ANSWER[:-1], AnswerError, "79 bytes"),
        (measured, ANSWER + b"\0", AnswerError, "81 bytes"),
        (measured, b"\xff" * 80, AnswerError, "from ff to ff"),
        (measured, b"\x7f" + ANSWER[1:], AnswerError, "from 7f to 0f"),
        (measured, ANSWER[:-1] + b"\x0e", AnswerError, "from 7e to 0e"),
        (measured, b"\x7e" + b"\xff" * 78 + b"\x0f", AnswerError, "not finite"),
    ],
    ids=lambda part: getattr(part, "__name__", part if isinstance(part, str) else ""),
)
def test_what_is_no_frame_and_no_answer_is_rejected_with_the_reason(
    call: Callable[[Any], object], wrong: object, error: type[Exception], sentence: str
) -> None:
    with pytest.raises(error, match=sentence):
        call(wrong)


# ---- answers


@given(st.binary(max_size=100) | st.binary(min_size=78, max_size=78).map(lambda middle: b"\x7e" + middle + b"\x0f"))
def test_whatever_comes_is_measured_or_rejected(data: bytes) -> None:
    try:
        values = measured(data)
    except AnswerError:
        return
    numbers = [value for field in values for value in (field if isinstance(field, tuple) else (field,))]
    assert len(numbers) == 19
    assert all(map(math.isfinite, numbers))
    assert values.tilt_deg is None or 0 <= values.tilt_deg <= 180
    assert answer(values)[:77] == data[:77]


# ---- the tilt

HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("orientation_wxyz", "tilt_deg"),
    [
        ((1.0, 0.0, 0.0, 0.0), 0),
        ((HALF, 0.0, 0.0, HALF), 0),  # turned to the left
        ((HALF, HALF, 0.0, 0.0), 90),
        ((0.0, 1.0, 0.0, 0.0), 180),
        ((math.cos(math.radians(10)), 0.0, math.sin(math.radians(10)), 0.0), 20),
        ((1.05 * HALF, 1.05 * HALF, 0.0, 0.0), 90),
    ],
)
def test_the_tilt_is_between_the_bodys_up_and_the_worlds(
    orientation_wxyz: tuple[float, float, float, float], tilt_deg: float
) -> None:
    values = measured(ANSWER)._replace(orientation_wxyz=orientation_wxyz)
    assert values.tilt_deg == pytest.approx(tilt_deg, abs=1e-5)
    assert measured(answer(values)).tilt_deg == pytest.approx(tilt_deg, abs=0.05), "in single precision"


@pytest.mark.parametrize(
    "orientation_wxyz", [(0.0, 0.0, 0.0, 0.0), (0.8, 0.0, 0.0, 0.0), (1.2, 0.0, 0.0, 0.0), (1e30, 1e30, 0.0, 0.0)]
)
def test_a_quaternion_far_from_its_length_says_no_tilt(orientation_wxyz: tuple[float, float, float, float]) -> None:
    assert measured(ANSWER)._replace(orientation_wxyz=orientation_wxyz).tilt_deg is None


# ---- the UART


def test_the_messages_are_the_published_ones() -> None:
    assert START.hex(" ") == "7e 21 87 00 00 00 00 00 ff 0f"
    assert SHUTDOWN.hex(" ") == "7e 11 38 00 00 00 00 00 ff 0f"
    assert heartbeat(bytes(range(16))).hex() == "7eaa000102030405060708090a0b0c0d0e0fff0f"
    assert (len(heartbeat()), UART_BAUD) == (HEARTBEAT_BYTES, 1_152_000)


junk = st.binary(max_size=30).filter(lambda data: b"\x7e" not in data)
"""Without the byte that may begin a heartbeat."""


@given(st.lists(junk), st.data())
def test_heartbeats_are_counted_in_all_portions(parts: list[bytes], data: st.DataObject) -> None:
    content = st.binary(min_size=16, max_size=16)
    stream = b"".join(part + heartbeat(data.draw(content)) for part in parts)
    found, rest = 0, b""
    while stream:
        length = data.draw(st.integers(1, len(stream)))
        count, rest = heartbeats(rest + stream[:length])
        found, stream = found + count, stream[length:]
    assert found == len(parts)


@given(st.lists(st.binary(max_size=50), max_size=30))
def test_whatever_comes_no_more_is_kept_than_one_heartbeat_needs(parts: list[bytes]) -> None:
    rest = b""
    for part in parts:
        count, rest = heartbeats(rest + part)
        assert count * HEARTBEAT_BYTES <= HEARTBEAT_BYTES - 1 + len(part)
        assert len(rest) < HEARTBEAT_BYTES
    assert heartbeats(bytes(HEARTBEAT_BYTES) + 2 * heartbeat()) == (2, b"")


@given(st.integers(2, HEARTBEAT_BYTES - 1))
def test_a_heartbeat_that_was_cut_off_costs_none_behind_it(length: int) -> None:
    assert heartbeats(heartbeat()[:length] + 3 * heartbeat())[0] == 3


@pytest.mark.parametrize(
    ("mask", "data"),
    [(0, "000000"), (1, "000001"), (1 << 8, "000100"), (1 << 15, "008000"), (1 << 17, "020000"), (ALL, "03ffff")],
)
def test_bit_n_minus_1_of_a_mask_is_output_n(mask: int, data: str) -> None:
    assert set_supply(mask) == (0x6A, bytes.fromhex(data))
    assert mask_of(set_supply(mask)) == mask
    assert read(CanFrame(0x6B, bytes.fromhex(data))) == mask


@pytest.mark.parametrize("mask", [-1, ALL + 1])
def test_a_mask_has_18_bits(mask: int) -> None:
    with pytest.raises(ValueError, match="18 outputs"):
        set_supply(mask)


ANSWERS: dict[str, tuple[int, str, Answer]] = {
    "currents 1-3": (0x71, "0001 0203 ffff", BoardValues(0x70, (1, 0x203, 65535))),
    "currents 16-18": (0x7B, "0064 00c8 012c", BoardValues(0x7A, (100, 200, 300))),
    "manipulator, 5 V, 3.3 V": (0x7D, "0001 0002 0003", BoardValues(0x7C, (1, 2, 3))),
    "standby, supply": (0x7F, "0014 0bb8", BoardValues(0x7E, (20, 3000))),
    "converters 1-3": (0x81, "1ce8 1ce8 1ce8", BoardValues(0x80, (7400, 7400, 7400))),
    "converters 4, 5": (0x83, "1388 1388", BoardValues(0x82, (5000, 5000))),
    "supply, battery": (0x85, "39d0 39d0", BoardValues(0x84, (14800, 14800))),
    "temperatures": (0x87, "001e fff6 0000", BoardValues(0x86, (30, -10, 0))),
    "no error": (0x65, "", CanFrame(0x65)),
    "deleted": (0x97, "", CanFrame(0x97)),
    "off button": (0x69, "", CanFrame(0x69)),
    "going off": (0x67, "", CanFrame(0x67)),
}


@pytest.mark.parametrize(("identifier", "data", "answer"), ANSWERS.values(), ids=ANSWERS)
def test_an_answer_is_read_and_one_of_another_length_is_none_or_an_unknown_error(
    identifier: int, data: str, answer: Answer
) -> None:
    whole = bytes.fromhex(data)
    assert read(CanFrame(identifier, whole)) == answer
    other = UNREADABLE if identifier == 0x65 else None
    assert read(CanFrame(identifier, whole + b"\0")) == other
    if len(whole) > 1:
        assert read(CanFrame(identifier, whole[:-1])) == other


@pytest.mark.parametrize("data", ["03 01", "00", "04", "01", "08 00", "02 0001", "01 20", "04 20", "02 040000"])
def test_an_error_frame_that_is_not_in_the_table_is_an_unknown_error_that_may_concern_every_output(data: str) -> None:
    error = read(CanFrame(0x65, bytes.fromhex(data)))
    assert error == UNREADABLE == BoardError(0, "the power board reports an error that cannot be read", ALL)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
@example(0x6C, bytes(3))
def test_whatever_comes_is_read_or_none(identifier: int, data: bytes) -> None:
    answer = read(CanFrame(identifier, data))
    if isinstance(answer, int):
        assert set_supply(answer).data == data
    mask = mask_of(CanFrame(identifier, data))
    assert mask is None or (identifier in (0x6A, 0x6B) and mask <= ALL)


@pytest.mark.parametrize(
    ("data", "named", "outputs"),
    [
        ("02 000005", "overcurrent: the power board has switched these servos off", (1, 3)),
        ("02 020000", "overcurrent: the power board has switched these servos off", (18,)),
        ("02 03ffff", "overcurrent: the power board has switched these servos off", range(1, 19)),
        ("01 01", "overcurrent: … its converter 1", range(1, 7)),
        ("01 02", "overcurrent: … its converter 2", range(7, 13)),
        ("01 04", "overcurrent: … its converter 3", range(13, 19)),
        ("01 08", "overcurrent: … its converter 4", ()),
        ("01 10", "overcurrent: … its converter 5", ()),
        ("01 1f", "overcurrent: … its converter 1 and 2 and 3 and 4 and 5", range(1, 19)),
        ("04 07", "overtemperature: … its converter 1 and 2 and 3", range(1, 19)),
        ("04 10", "overtemperature: … its converter 5", ()),
        ("08", "the power board's supply is too low", ()),
    ],
    ids=str,
)
def test_an_error_says_what_is_off(data: str, named: str, outputs: Collection[int]) -> None:
    begin, _, end = named.rpartition("…")
    whole = bytes.fromhex(data)
    error = read(CanFrame(0x65, whole))
    assert isinstance(error, BoardError)
    assert error.code == whole[0]
    assert error.why.startswith(begin.strip())
    assert error.why.endswith(end)
    assert {number for number in range(1, 32) if error.outputs >> (number - 1) & 1} == set(outputs)
    assert read(CanFrame(0x65, whole + b"\0")) == UNREADABLE


def test_each_question_is_named_once() -> None:
    questions = [question.id for question in (*ASK_CURRENTS, *ASK_RAILS)]
    assert questions == list(range(0x70, 0x88, 2))
