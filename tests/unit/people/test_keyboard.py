"""The bytes of a terminal as keys: an escape counts at once, and is no part of an arrow."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.people.terminal.keyboard import Keyboard

ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1bOD": "left"}


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b"a", ["a"]),
        (b" 9.\r", [" ", "9", ".", "enter"]),
        (b"\x03", ["ctrl-c"]),
        (b"\x1b", ["escape"]),
        (b"\x1b\x1b", ["escape", "escape"]),
        (b"\x1b[C\x1b[C", ["right", "right"]),
        (b"\x1b[C ", ["right", " "]),
        (b"\x1b[1;5C", []),  # with Ctrl
        (b"\x1b[3~x", ["x"]),
        (b"\x1b[200~11\r\x1b[201~", ["1", "1", "enter"]),
        ("°ä".encode(), []),
        (b"\x7f\x01", ["backspace"]),
        (b"", []),
    ],
)
def test_keys(data: bytes, keys: list[str]) -> None:
    assert Keyboard().keys(data, 0.0) == keys


@pytest.mark.parametrize("data", ARROWS)
def test_an_arrow_that_comes_in_two_parts_is_an_escape_and_nothing_else(data: bytes) -> None:
    keyboard = Keyboard()
    assert keyboard.keys(data[:1], 1.0) == ["escape"]
    assert keyboard.keys(data[1:] + b"x", 1.01) == ["x"]


def test_what_a_person_types_after_an_escape_counts() -> None:
    keyboard = Keyboard()
    assert keyboard.keys(b"\x1b", 1.0) == ["escape"]
    assert keyboard.keys(b"[", 1.2) == ["["]


PIECES = st.binary(max_size=4) | st.sampled_from([b"\x1b", b"[", b"\x1b[", b"\x1b[1;", b"\x1bO", b" "])


@given(st.lists(st.lists(PIECES).map(b"".join)))
def test_a_space_is_always_a_key(parts: list[bytes]) -> None:
    keyboard = Keyboard()
    for part in parts:
        assert keyboard.keys(part, 0.0).count(" ") == part.count(b" ")
