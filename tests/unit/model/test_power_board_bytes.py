"""The bytes of the power board: literals from its firmware, and whatever else a bus may carry."""

from collections.abc import Collection

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

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
