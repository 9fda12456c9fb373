"""The bytes of elkapod-2025: the published vectors as literals, and whatever else a wire may carry."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
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
from tests.support.elkapod import angles_of

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
FIELDS = range(19)
"""An answer's numbers; number n is at byte 1 + 4 n."""


# ---- frames


@pytest.mark.parametrize(
    ("place", "servo_id", "cdeg", "at", "four_bytes"),
    [
        (0, 11, 0, 1, "00000000"),
        (2, 13, 180_00, 9, "00003443"),
        (17, 63, 1, 69, "0ad7233c"),
    ],
)
def test_each_servo_has_its_four_bytes(place: int, servo_id: int, cdeg: int, at: int, four_bytes: str) -> None:
    angles_cdeg = [MIDDLE_CDEG] * 18
    angles_cdeg[place] = cdeg
    data = frame(angles_cdeg)
    assert data[at : at + 4].hex() == four_bytes
    assert data[:at] + data[at + 4 :] == frame([MIDDLE_CDEG] * 18)[:at] + frame([MIDDLE_CDEG] * 18)[at + 4 :]
    assert angles_of(data)[servo_id] == pytest.approx(cdeg / 100)


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
    assert len(numbers) == len(FIELDS)
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
