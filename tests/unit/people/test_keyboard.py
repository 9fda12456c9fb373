"""The bytes of a terminal as keys: an escape counts at once, and is no part of an arrow."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.people.terminal.keyboard import Keyboard

PIECES = st.binary(max_size=4) | st.sampled_from([b"\x1b", b"[", b"\x1b[", b"\x1b[1;", b"\x1bO", b" "])


@given(st.lists(st.lists(PIECES).map(b"".join)))
def test_a_space_is_always_a_key(parts: list[bytes]) -> None:
    keyboard = Keyboard()
    for part in parts:
        assert keyboard.keys(part, 0.0).count(" ") == part.count(b" ")
