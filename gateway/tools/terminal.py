"""What a command prints: results on stdout, remarks on stderr."""

import shutil
import sys
from pathlib import Path


def this_command() -> str:
    """How this program was called, so that a line that names it can be copied: `.venv/bin/…` after `make run`."""
    called, found = sys.argv[0], shutil.which("hexapod-gateway")
    if called.endswith("__main__.py") or (found is not None and Path(called).absolute() == Path(found).absolute()):
        return "hexapod-gateway"
    return called


def visible(text: str) -> str:
    """The text on one line, without control characters: a stranger's name must not control the terminal."""
    return text if text.isprintable() else "".join(char if char.isprintable() else "�" for char in text)


def say(text: str) -> None:
    """A line of result, on stdout."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def hint(text: str) -> None:
    """A line for the person, on stderr, so that pipes carry results only."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
