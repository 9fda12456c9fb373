"""The bytes of the power board: literals from its firmware, and whatever else a bus may carry."""

from collections.abc import Collection

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.model.power_board import (
    ALL,
    ASK_CURRENTS,
    ASK_RAILS,
    CONVERTER_OVERCURRENT,
    OVERTEMPERATURE,
    SERVO_OVERCURRENT,
    SUPPLY_LOW,
    TWO_BOARDS,
    UNREADABLE,
    Answer,
    BoardError,
    BoardNotice,
    CanFrame,
    Currents,
    Rails,
    Supplied,
    explained,
    mask_of,
    read,
    set_supply,
)


@pytest.mark.parametrize(
    ("mask", "data"),
    [(0, "000000"), (1, "000001"), (1 << 8, "000100"), (1 << 15, "008000"), (1 << 17, "020000"), (ALL, "03ffff")],
)
def test_bit_n_minus_1_of_a_mask_is_output_n(mask: int, data: str) -> None:
    assert set_supply(mask) == (0x6A, bytes.fromhex(data))
    assert mask_of(set_supply(mask)) == mask
    assert read(CanFrame(0x6B, bytes.fromhex(data))) == Supplied(mask)


@pytest.mark.parametrize("mask", [-1, ALL + 1])
def test_a_mask_has_18_bits(mask: int) -> None:
    with pytest.raises(ValueError, match="18 outputs"):
        set_supply(mask)


ANSWERS: dict[str, tuple[int, str, Answer]] = {
    "currents 1-3": (0x71, "0001 0203 ffff", Currents(1, (1, 0x203, 65535))),
    "currents 16-18": (0x7B, "0064 00c8 012c", Currents(16, (100, 200, 300))),
    "manipulator, 5 V, 3.3 V": (0x7D, "0001 0002 0003", Rails(0x7C, (1, 2, 3))),
    "standby, supply": (0x7F, "0014 0bb8", Rails(0x7E, (20, 3000))),
    "converters 1-3": (0x81, "1ce8 1ce8 1ce8", Rails(0x80, (7400, 7400, 7400))),
    "converters 4, 5": (0x83, "1388 1388", Rails(0x82, (5000, 5000))),
    "supply, battery": (0x85, "39d0 39d0", Rails(0x84, (14800, 14800))),
    "temperatures": (0x87, "001e fff6 0000", Rails(0x86, (30, -10, 0))),
    "no error": (0x65, "", BoardNotice.NO_ERROR),
    "servo 18": (0x65, "02 020000", BoardError(2, 1 << 17)),
    "all converters": (0x65, "01 1f", BoardError(1, 0b11111)),
    "all servos": (0x65, "02 03ffff", BoardError(2, ALL)),
    "too hot, sensor 1": (0x65, "04 07", BoardError(4, 0b111)),
    "too hot, sensor 2": (0x65, "04 10", BoardError(4, 0b10000)),
    "supply low": (0x65, "08", BoardError(8)),
    "deleted": (0x97, "", BoardNotice.CLEARED),
    "off button": (0x69, "", BoardNotice.OFF_PRESSED),
    "going off": (0x67, "", BoardNotice.GOING_OFF),
}


@pytest.mark.parametrize(("identifier", "data", "answer"), ANSWERS.values(), ids=ANSWERS)
def test_an_answer_is_read_and_one_of_another_length_is_none_or_an_unknown_error(
    identifier: int, data: str, answer: Answer
) -> None:
    whole = bytes.fromhex(data)
    assert read(CanFrame(identifier, whole)) == answer
    other = BoardError(UNREADABLE) if identifier == 0x65 else None
    assert read(CanFrame(identifier, whole + b"\0")) == other
    if len(whole) > 1:
        assert read(CanFrame(identifier, whole[:-1])) == other


@pytest.mark.parametrize("data", ["03 01", "00", "04", "01", "08 00", "02 0001", "01 20", "04 20", "02 040000"])
def test_an_error_frame_that_is_not_in_the_table_is_an_unknown_error_that_may_concern_every_output(data: str) -> None:
    error = read(CanFrame(0x65, bytes.fromhex(data)))
    assert error == BoardError(UNREADABLE)
    assert explained(BoardError(UNREADABLE)) == ("the power board reports an error that cannot be read", ALL)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
@example(0x6C, bytes(3))
def test_whatever_comes_is_read_or_none(identifier: int, data: bytes) -> None:
    answer = read(CanFrame(identifier, data))
    if isinstance(answer, Supplied):
        assert set_supply(answer.mask).data == data
    mask = mask_of(CanFrame(identifier, data))
    assert mask is None or (identifier in (0x6A, 0x6B) and mask <= ALL)


@pytest.mark.parametrize(
    ("error", "named", "outputs"),
    [
        (BoardError(SERVO_OVERCURRENT, 0b101), "overcurrent: the power board has switched these servos off", (1, 3)),
        (BoardError(CONVERTER_OVERCURRENT, 0b1), "overcurrent: … its converter 1", range(1, 7)),
        (BoardError(CONVERTER_OVERCURRENT, 0b10), "overcurrent: … its converter 2", range(7, 13)),
        (BoardError(CONVERTER_OVERCURRENT, 0b100), "overcurrent: … its converter 3", range(13, 19)),
        (BoardError(CONVERTER_OVERCURRENT, 0b1000), "overcurrent: … its converter 4", ()),
        (BoardError(CONVERTER_OVERCURRENT, 0b10000), "overcurrent: … its converter 5", ()),
        (BoardError(CONVERTER_OVERCURRENT, 0b11), "overcurrent: … its converter 1 and 2", range(1, 13)),
        (BoardError(OVERTEMPERATURE, 0b111), "overtemperature: … its converter 1 and 2 and 3", range(1, 19)),
        (BoardError(OVERTEMPERATURE, 0b10000), "overtemperature: … its converter 5", ()),
        (BoardError(TWO_BOARDS), "two power boards answer on this bus; … and reset", range(1, 19)),
        (BoardError(SUPPLY_LOW), "the power board's supply is too low", ()),
    ],
    ids=str,
)
def test_an_error_is_explained_and_says_which_outputs_are_off(
    error: BoardError, named: str, outputs: Collection[int]
) -> None:
    begin, _, end = named.rpartition("…")
    sentence, mask = explained(error)
    assert sentence.startswith(begin.strip())
    assert sentence.endswith(end)
    assert {number for number in range(1, 32) if mask >> (number - 1) & 1} == set(outputs)


def test_each_question_is_named_once() -> None:
    questions = [question.id for question in (*ASK_CURRENTS, *ASK_RAILS)]
    assert questions == list(range(0x70, 0x88, 2))
