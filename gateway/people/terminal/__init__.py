"""What a command prints (results on stdout, remarks on stderr), what it asks, and how it is asked to end.

`screen` is the frame of programs that fill the terminal.
"""

import importlib.util
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, Self

from gateway.errors import ConfigError, GatewayError
from gateway.text import visible

_REDRAW_S: Final = 0.2
"""How often a line of progress changes."""
NOBODY: Final = "this is no terminal, so nobody can be asked; --yes agrees"


def say(text: str) -> None:
    """A line of result, on stdout. It may contain foreign text."""
    sys.stdout.write(f"{visible(text)}\n")
    sys.stdout.flush()


class Progress:
    """One line on the terminal that changes while something takes long; nothing where there is no terminal."""

    def __init__(self) -> None:
        self._shown_s = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Clear the line."""
        clear_line()

    def show(self, text: str) -> None:
        """Show this, unless something was shown just now."""
        now_s = time.monotonic()
        if now_s - self._shown_s >= _REDRAW_S:
            self._shown_s = now_s
            show_line(text)


def show_line(text: str) -> None:
    """Replace the line of progress; do nothing where stderr is no terminal."""
    if sys.stderr.isatty():
        columns = shutil.get_terminal_size().columns  # a line that wraps would be written below itself each time
        sys.stderr.write(f"\r\x1b[K{text[: columns - 1]}")
        sys.stderr.flush()


def clear_line() -> None:
    """End the progress, so that the next output has a line of its own."""
    show_line("")


def hint(text: str) -> None:
    """A line for the person, on stderr, so that pipes carry results only. It may contain foreign text."""
    sys.stderr.write(f"{visible(text)}\n")
    sys.stderr.flush()


def check_terminal(
    program: str, otherwise: str, *, on_windows: str = "", error: type[GatewayError] = GatewayError
) -> None:
    """Raises `error` where the program cannot fill this terminal.

    `otherwise` continues the sentence with what to do instead.
    """
    if importlib.util.find_spec("termios") is None:
        raise error(f"{program} needs a Unix terminal; on Windows, run it in WSL{on_windows}")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise error(f"{program} needs a terminal{otherwise}")


def ask(question: str) -> str:
    """One typed line, in lower case; "" at the end of the input."""
    sys.stderr.write(question)
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower()


def agrees(question: str, *, nobody: str = NOBODY) -> bool:
    """Whether a person answers yes. Raises ConfigError, with the sentence `nobody`, where stdin is no terminal."""
    if not sys.stdin.isatty():
        raise ConfigError(nobody)
    return ask(f"{question} [y/N] ") in ("y", "yes")


@contextmanager
def on_end_signals(end: Callable[[], object]) -> Iterator[None]:
    """Call `end`, which must not wait, on Ctrl-C, SIGTERM and the end of the terminal."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        end()

    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
