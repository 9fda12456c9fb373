"""The bytes of a terminal as keys: Escape is no part of an arrow key."""

import re
import signal

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.people.commands.walk.screen import REPEATED_S, SPEEDS, STOP_KEYS, Keypad
from gateway.people.terminal import Keyboard, on_end_signals
from gateway.people.walking.motion import STILL

SPACES = (" ", "\0", "\u00a0", "\u202f", "\u3000")
"""Alone, with Ctrl, with AltGr, with Shift, and of full width."""
PIECES = st.binary(max_size=4) | st.sampled_from(
    [b"\x1b", b"[", b"\x1b[", b"\x1b[1;", b"\x1bO", *map(str.encode, SPACES)]
)


@given(st.lists(st.lists(PIECES).map(b"".join)))
@example([each.encode() for each in SPACES])
def test_the_space_bar_is_always_a_key_that_stops_whatever_else_is_held(parts: list[bytes]) -> None:
    keyboard = Keyboard()
    for part in parts:
        spaces = re.findall("|".join(SPACES).encode(), part)
        assert keyboard.keys(part).count(" ") == len(spaces)
    assert " " in STOP_KEYS


@pytest.mark.parametrize(
    ("parts", "keys"),
    [
        ([b"\x1b", b""], ["escape"]),
        ([b"\x1b\x1b"], ["escape"]),
        ([b"\x1b", b"w"], ["escape", "w"]),
        ([b"\x1b[A\x1bOB"], ["up", "down"]),
        ([b"\x1b[", b"A"], ["up"]),
        ([b"\x1b[1;", b"5A"], []),
        ([b"\x1b", b"", b"[A"], ["escape", "[", "A"]),
        ([b"\x1b[15~w"], ["w"]),
        (["цфыв".encode(), "ЦйУ".encode()], [*"wasdwqe"]),
        (["ςασδ".encode()], [*"wasd"]),
        ([b"\xd1", b"\x86"], ["w"]),
        (["é".encode()], ["é"]),
    ],
)
def test_escape_is_a_key_unless_an_arrow_follows(parts: list[bytes], keys: list[str]) -> None:
    keyboard = Keyboard()
    assert [key for part in parts for key in keyboard.keys(part)] == keys


def test_a_terminal_that_goes_does_not_end_what_nohup_keeps_running() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with on_end_signals(lambda: None):
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) != signal.SIG_DFL
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with on_end_signals(lambda: None):
            assert signal.getsignal(signal.SIGHUP) != signal.SIG_DFL
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


# ---- held keys: no terminal reports that one is released


@pytest.mark.parametrize(("pause_s", "every_s"), [(0.25, 0.03), (0.5, 0.033), (0.66, 0.04), (0.5, 0.09)])
def test_a_held_key_has_no_gap_and_ends_soon_after_its_release(pause_s: float, every_s: float) -> None:
    """X11's, GNOME's and Windows' repetitions."""
    pad = Keypad()
    pad.press("up", 0.0)
    now_s = 0.0
    while now_s < 3.0:
        assert pad.velocity(now_s).forward_m_s > 0
        if now_s >= pause_s:
            pad.press("up", now_s)
            last_s = now_s
            now_s += every_s
        else:
            now_s = min(pause_s, now_s + 0.02)
    assert pad.velocity(last_s + REPEATED_S - 0.01) != STILL
    assert pad.velocity(last_s + REPEATED_S) == STILL


def test_another_key_ends_a_motion_and_the_newest_counts() -> None:
    pad = Keypad()
    pad.press("w", 0.0)
    pad.press("left", 0.1)
    assert pad.velocity(0.1).turn_rad_s > 0
    assert pad.velocity(0.1).forward_m_s == 0
    assert not pad.press("t", 0.2)
    assert pad.velocity(0.2) == STILL


def test_the_speed_has_ends() -> None:
    pad = Keypad()
    for _ in range(20):
        assert pad.press("+", 0.0)
    assert pad.speed_m_s == SPEEDS[-1]
    for _ in range(20):
        pad.press("-", 0.0)
    assert pad.speed_m_s == SPEEDS[0]
    pad.press("A", 0.0)
    assert pad.velocity(0.0).left_m_s == SPEEDS[0]
