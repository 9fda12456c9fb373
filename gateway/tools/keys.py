"""A terminal that gives each key as it is pressed, and signals that end such a program in order. Unix only."""

import contextlib
import os
import signal
import termios
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def keys_at_once(terminal: int) -> Iterator[None]:
    """Keys come one by one and unseen, Ctrl-C as a key, and Ctrl-S stops nothing; afterwards all is as before."""
    before = termios.tcgetattr(terminal)
    during = termios.tcgetattr(terminal)
    during[0] &= ~(termios.IXON | termios.IXOFF)
    during[3] &= ~(termios.ICANON | termios.ECHO | termios.ISIG)
    during[6][termios.VMIN], during[6][termios.VTIME] = 1, 0
    termios.tcsetattr(terminal, termios.TCSANOW, during)
    try:
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSANOW, before)


@contextlib.contextmanager
def wake_on_signals() -> Iterator[tuple[int, int]]:
    """A descriptor that becomes readable when a signal asks for the end, and the one to write to for the same."""
    readable, writable = os.pipe()

    def wake(_number: int, _frame: FrameType | None) -> None:
        os.write(writable, b".")

    before = {number: signal.signal(number, wake) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}
    try:
        yield readable, writable
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(readable)
        os.close(writable)
