"""The bytes of a terminal as keys: an escape counts at once, and is no part of an arrow."""

import signal

from hypothesis import given
from hypothesis import strategies as st

from gateway.people.terminal import on_end_signals
from gateway.people.terminal.keyboard import Keyboard

PIECES = st.binary(max_size=4) | st.sampled_from([b"\x1b", b"[", b"\x1b[", b"\x1b[1;", b"\x1bO", b" "])


@given(st.lists(st.lists(PIECES).map(b"".join)))
def test_a_space_is_always_a_key(parts: list[bytes]) -> None:
    keyboard = Keyboard()
    for part in parts:
        assert keyboard.keys(part, 0.0).count(" ") == part.count(b" ")


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
