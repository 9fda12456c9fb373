"""A command's output (results on stdout, remarks on stderr), its questions, its keys, and its end by signals."""

import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Final

from gateway.words.text import visible

NOBODY: Final = "this is no terminal, so nobody can be asked; --yes agrees"


def say(text: str) -> None:
    """Print a line of result on stdout. `text` may contain foreign text."""
    sys.stdout.write(f"{visible(text)}\n")
    sys.stdout.flush()


def show_line(text: str) -> None:
    """Replace the line of progress, if stderr is a terminal."""
    if sys.stderr.isatty():
        columns = shutil.get_terminal_size().columns  # a wrapped line would not be replaced
        _remark(f"\r\x1b[K{text[: columns - 1]}")


def clear_line() -> None:
    """End the progress, so that the next output has a line of its own."""
    show_line("")


def hint(text: str) -> None:
    """Print a line for the person on stderr: pipes carry results only. `text` may contain foreign text."""
    _remark(f"{visible(text)}\n")


def _remark(text: str) -> None:
    with suppress(OSError):  # the terminal is closed, or the disk full: a robot that walks must not fall for that
        sys.stderr.write(text)
        sys.stderr.flush()


def ask(question: str) -> str:
    """Print `question`, and return one typed line in lower case; "" at the end of the input."""
    sys.stderr.write(question)
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower()


@contextmanager
def on_end_signals(end: Callable[[], object]) -> Iterator[None]:
    """Call `end`, which must not wait, at Ctrl-C, SIGTERM and the end of the terminal, during a `with`."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        end()

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup keeps it running
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


REST_S: Final = 0.05
"""How soon the rest of an arrow key follows its first bytes, if they arrive apart (a slow SSH)."""
_INCOMPLETE: Final = re.compile(rb"(\x1b([\[O][0-9;<?]*)?|[\xc3-\xdf])\Z")
_PIECES: Final = re.compile(
    rb"\x1b[\[O]([0-9;<?]*)([@-~]?)|([\xc2-\xdf][\x80-\xbf]|\xe2\x80\xaf|\xe3\x80\x80|.)", re.DOTALL
)
"""A control sequence (its parameters, its last byte), or another byte, or a letter or a space of several bytes."""
_LATIN: Final = dict(
    zip(
        "йцукенгшщзфывапролдячсмитьςερτυθιοπασδφγηξκλζχψωβνμ",
        "qwertyuiopasdfghjklzxcvbnmwertyuiopasdfghjklzxcvbnm",
        strict=True,
    )
)
"""The letters at the same places of a Russian and a Greek keyboard."""
_NAMES: Final = {
    b"\x1b": "escape", b"\r": "enter", b"\n": "enter", b"\x7f": "backspace", b"\b": "backspace", b"\x03": "ctrl-c",
    b"\0": " ", b"\xc2\xa0": " ", b"\xe2\x80\xaf": " ", b"\xe3\x80\x80": " ",
}  # fmt: skip
"""The space bar is the emergency stop: with Ctrl, AltGr, on some layouts Shift, or an input method it gives these."""
_ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}


@contextmanager
def keys_at_once(terminal: int) -> Iterator[None]:
    """Deliver keys one by one without echo, Ctrl-C as a key; Ctrl-S has no effect. Restores the terminal."""
    import termios  # the module also loads on Windows, which lacks this

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


@contextmanager
def wake_on_signals() -> Iterator[tuple[int, int]]:
    """Yield a descriptor that becomes readable at an end signal, and one to write to for the same effect."""
    readable, writable = os.pipe()
    try:
        with on_end_signals(lambda: os.write(writable, b".")):
            yield readable, writable
    finally:
        os.close(readable)
        os.close(writable)


class Keyboard:
    """Translates a terminal's bytes into keys: "a", "left", "enter", "escape"; others are left out.

    Letters of a Russian or a Greek keyboard become those at the same places: a terminal reports no places.

    An arrow key begins with the byte of Escape. So bytes that may be the beginning of one wait for the rest.
    """

    def __init__(self) -> None:
        self._begun = b""

    @property
    def waits(self) -> bool:
        """Whether bytes wait for their rest. Call `keys` with no data if none follows within REST_S."""
        return bool(self._begun)

    def keys(self, data: bytes) -> list[str]:
        """Return the keys in the bytes of one read. Empty: no more bytes follow those that wait."""
        more, data, self._begun = bool(data), self._begun + data, b""
        if more and (incomplete := _INCOMPLETE.search(data)):
            self._begun, data = incomplete[0], data[: incomplete.start()]
        found: list[str] = []
        for parameters, final, other in _PIECES.findall(data):
            if other in _NAMES:
                found.append(_NAMES[other])
            elif b" " <= other <= b"~":
                found.append(other.decode())
            elif len(other) == len(b"\xc3\xa9"):
                found.append(_LATIN.get(other.decode().lower(), other.decode()))
            elif not parameters and final in _ARROWS:  # with a number it is another key, or an arrow with Shift or Ctrl
                found.append(_ARROWS[final])
        return found
