"""A command's output (results on stdout, remarks on stderr), its questions, and its end by signals."""

import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from gateway.text import visible

NOBODY: Final = "this is no terminal, so nobody can be asked; --yes agrees"


def say(text: str) -> None:
    """Print a line of result on stdout. `text` may contain foreign text."""
    sys.stdout.write(f"{visible(text)}\n")
    sys.stdout.flush()


def show_line(text: str) -> None:
    """Replace the line of progress, if stderr is a terminal."""
    if sys.stderr.isatty():
        columns = shutil.get_terminal_size().columns  # a wrapped line would not be replaced
        sys.stderr.write(f"\r\x1b[K{text[: columns - 1]}")
        sys.stderr.flush()


def clear_line() -> None:
    """End the progress, so that the next output has a line of its own."""
    show_line("")


def hint(text: str) -> None:
    """Print a line for the person on stderr: pipes carry results only. `text` may contain foreign text."""
    sys.stderr.write(f"{visible(text)}\n")
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
