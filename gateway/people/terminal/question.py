"""What a command asks the person who called it."""

import sys
from typing import Final, TextIO

from gateway.errors import ConfigError

NOBODY: Final = "nobody can be asked here, since there is no terminal; --yes agrees"


def ask(question: str, out: TextIO | None = None) -> str:
    """One line of what somebody types, in lower case; "" where nobody does. `out`: where the question is printed."""
    out = out or sys.stderr
    out.write(question)
    out.flush()
    return sys.stdin.readline().strip().lower()


def agrees(question: str, *, nobody: str = NOBODY) -> bool:
    """Whether somebody says yes. Raises ConfigError, with the sentence `nobody`, where nobody can be asked."""
    if not sys.stdin.isatty():
        raise ConfigError(nobody)
    return ask(f"{question} [y/N] ") in ("y", "yes")
